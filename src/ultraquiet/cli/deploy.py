"""`ultraquiet deploy`: a controller as C99, compiled and compared."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError


def deploy(
    controller: Annotated[Path, typer.Argument(help="A controller (HDF5), as `design` leaves it.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the code; default: beside the controller.")] = None,
    precision: Annotated[str, typer.Option(help="float32 or float64.")] = "float32",
) -> None:
    """Generate C99, compile it with the system's compiler and compare it bit by bit with Python."""
    from rich.console import Console
    from rich.table import Table

    from ultraquiet import deploy as room
    from ultraquiet import files
    from ultraquiet.values import StateSpace

    law = files.load(controller)
    if not isinstance(law, StateSpace):
        raise InputError(f"deploy: '{controller}' holds a {type(law).__name__}, not a controller in state space.")
    folder = out or controller.with_suffix("")
    made = room.generate(law, folder, precision=precision)
    verified = made.verify()
    table = Table("what", "value", title=f"{folder}")
    for key, value in made.tables.items():
        table.add_row(key, str(value))
    console = Console()
    console.print(table)
    console.print(str(verified.status), highlight=False, soft_wrap=True)
