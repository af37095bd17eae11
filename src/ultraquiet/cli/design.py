"""`ultraquiet design`: one plant, one method."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.progress import bars
from ultraquiet.cli.settings import method as make


def design(
    plant: Annotated[Path, typer.Argument(help="A model or state space (HDF5), as `identify` leaves it.")],
    method: Annotated[
        str, typer.Option(help="A registered method; see `ultraquiet methods design`.")
    ] = "mixed-sensitivity",
    out: Annotated[
        Path | None, typer.Option(help="Where the controller goes (HDF5); default: beside the plant.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing controller.")] = False,
    setting: Annotated[list[str] | None, typer.Option("--set", help="A setting of the method, key=value.")] = None,
) -> None:
    """Design a controller u = K y; a refusal says why and leaves nothing."""
    from rich.console import Console

    from ultraquiet import files
    from ultraquiet.design.robustness import described
    from ultraquiet.values import StateSpace, StatusWord

    model = files.load(plant)
    system = model if isinstance(model, StateSpace) else getattr(model, "state_space", lambda: None)()
    if system is None:
        raise InputError(f"design: '{plant}' holds a {type(model).__name__}, not a model of a plant.")
    settings = make("design", method, setting or ())
    with bars():
        result = settings.design(system)
    if result.controller is None:
        error = InputError if result.status.word is StatusWord.REFUSED else NumericalError
        raise error(f"design: {result.status.sentence}")
    target = out or plant.with_name(f"{plant.stem}-{method}.h5")
    files.save(result.controller, target, overwrite=force)
    console = Console()
    console.print(f"{result.status}", highlight=False, soft_wrap=True)
    for line in described(system, result.margins):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"{result.controller.states} states\ncontroller: {target}", highlight=False, soft_wrap=True)
    finish(result.status)
