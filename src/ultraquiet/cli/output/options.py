"""What every command takes: `--json` and `--quiet`."""

import inspect
import sys
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.cli.output.screen import Screen, showing

Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON, and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no words, tables or progress; the exit code tells.")]
OPTIONS = {"as_json": Json, "quiet": Quiet}
# Of what is wrong with words as such; Typer brings it from one place or another, by its version.
USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]


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
        try:
            return super().parse_args(ctx, list(args))
        except USAGE_ERROR as error:
            option = self._of_names_apart(args)
            if option is None or "extra argument" not in str(error):
                raise
            raise InputError(
                f"{ctx.info_name}: '{option}' takes one word, and more follow it; write several names as one, "
                f"separated by commas: {option} 'first,second'."
            ) from None

    def _of_names_apart(self, args: list[str]) -> str | None:
        """Return an option for names separated by commas that several words follow, None where there is none."""
        several = {o for p in self.params if "separated by commas" in (getattr(p, "help", "") or "") for o in p.opts}
        for k, word in enumerate(args):
            after = args[k + 1 : k + 3]
            if word in several and len(after) == 2 and not any(a.startswith("-") for a in after):
                return word
        return None


def _bytecode() -> str:
    """Return where Python keeps what it compiled."""
    return f"'{sys.pycache_prefix}'" if sys.pycache_prefix else "the folders named '__pycache__'"


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with `--json` and `--quiet` after its own options."""

    @wraps(command)
    def run(*, as_json: bool = False, quiet: bool = False, **options: Any) -> None:
        try:
            with showing(Screen(as_json, quiet)):
                command(**options)
        except EOFError as error:  # typer takes it for the end of what is typed, and says no more than "Aborted!"
            raise StorageError(
                f"a file of compiled Python was cut short, as a full disk leaves it ({error}); remove {_bytecode()} and"
                " try again."
            ) from error

    own = inspect.signature(command, eval_str=True)
    keyword = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter(name, keyword, default=False, annotation=kind) for name, kind in OPTIONS.items()]
    signature = own.replace(parameters=[*own.parameters.values(), *more])
    run.__dict__.pop("__wrapped__")  # typer reads signature and annotations from what it is given
    run.__dict__["__signature__"] = signature
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run
