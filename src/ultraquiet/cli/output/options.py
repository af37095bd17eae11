"""What every command takes: `--json` and `--quiet`."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

from ultraquiet.cli.output.screen import Screen, showing

Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON, and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no words, tables or progress; the exit code tells.")]
OPTIONS = {"as_json": Json, "quiet": Quiet}


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
