"""`ultraquiet validate`: a model beside a record it has not seen."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError

STEPS = (1, 10)
P_VALUES = ("p: white", "p: free of input", "p: no feedback")


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
    ahead = [] if tested is None else [room.compare(held, data, steps=k).fit_percent for k in STEPS]
    named = [f"{k} ahead" for k in STEPS]
    table = Table("output", "simulated fit", *named, "clipped", *P_VALUES, title=f"{model} on {record}")
    for i, channel in enumerate(data.sensors):
        steps = [f"{fit[i]:.2f} %" for fit in ahead] or ["-"] * len(STEPS)
        tests = ["-"] * len(P_VALUES)
        if tested is not None:
            values = (tested.whiteness_p[i], tested.correlation_p[i].min(), tested.feedback_p[i].min())
            tests = [f"{p:.3g}" for p in values]
        table.add_row(channel.name, f"{found.fit_percent[i]:.2f} %", *steps, str(found.clipped[i]), *tests)
    console = Console()
    console.print(table)
    if tested is not None:
        console.print(f"p-values take the coefficients as fitted to {tested.origin}.")
    for advice in room.advise(data, None if isinstance(held, StateSpace) else held):
        console.print(str(advice), markup=False)
