"""`ultraquiet validate`: a model beside a record it has not seen."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError


def validate(
    model: Annotated[Path, typer.Argument(help="A model (HDF5), as `identify` leaves it.")],
    record: Annotated[Path, typer.Argument(help="A record, of any format that `convert` reads.")],
    rate: Annotated[float | None, typer.Option(help="Samples per second, when the file does not say.")] = None,
    inputs: Annotated[str | None, typer.Option(help="The inputs in the file, separated by commas.")] = None,
    outputs: Annotated[str | None, typer.Option(help="The outputs in the file, separated by commas.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="Channels of the file (TOML), instead of --inputs and --outputs.")
    ] = None,
) -> None:
    """Simulate a model with a record's inputs and test what it leaves unexplained."""
    from rich.console import Console
    from rich.table import Table

    from ultraquiet import files
    from ultraquiet import validate as room
    from ultraquiet.values import PolynomialMatrix, PolynomialModel, StateSpace

    held = files.load(model)
    if not isinstance(held, PolynomialMatrix | PolynomialModel | StateSpace):
        raise InputError(f"validate: '{model}' holds a {type(held).__name__}, not a model.")
    data = files.read_record(record, rate, inputs, outputs, mapping)
    found = room.compare(held, data)
    tested = None if isinstance(held, StateSpace) else room.residual_test(held, data)
    table = Table("output", "simulated fit", "clipped", "p: white", "p: free of input", title=f"{model} on {record}")
    for i, channel in enumerate(data.sensors):
        tests = (
            ("-", "-") if tested is None else (f"{tested.whiteness_p[i]:.3g}", f"{tested.correlation_p[i].min():.3g}")
        )
        table.add_row(channel.name, f"{found.fit_percent[i]:.2f} %", str(found.clipped[i]), *tests)
    Console().print(table)
