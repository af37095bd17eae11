"""What every command takes: `--json` and `--quiet`."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ultraquiet._base.errors import InputError
from ultraquiet.cli.output.screen import Screen, showing

Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON, and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no words, tables or progress; the exit code tells.")]
OPTIONS = {"as_json": Json, "quiet": Quiet}


class NoEmptyWords(TyperCommand):
    """A command that takes no empty word: as a path it would be the current folder, which nobody named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an empty word by the option or the place it stands at."""
        for k, word in enumerate(args):
            name, sign, value = word.partition("=")
            option = name if sign and name.startswith("--") and not value.strip() else None
            if not word.strip():
                option = args[k - 1] if k and args[k - 1].startswith("-") else f"argument {k + 1}"
            if option is not None:
                raise InputError(
                    f"{ctx.info_name}: '{option}' was given nothing; write what is meant, or leave it away."
                )
        return super().parse_args(ctx, args)


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with `--json` and `--quiet` after its own options."""

    @wraps(command)
    def run(*, as_json: bool = False, quiet: bool = False, **options: Any) -> None:
        with showing(Screen(as_json, quiet)):
            command(**options)

    own = inspect.signature(command, eval_str=True)
    keyword = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter(name, keyword, default=False, annotation=kind) for name, kind in OPTIONS.items()]
    signature = own.replace(parameters=[*own.parameters.values(), *more])
    run.__dict__.pop("__wrapped__")  # typer reads signature and annotations from what it is given
    run.__dict__["__signature__"] = signature
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run
