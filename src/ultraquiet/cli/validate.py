"""`ultraquiet validate`: a model beside a record it has not seen."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from ultraquiet._base.errors import InputError
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.loop.loaded import loaded

if TYPE_CHECKING:
    from ultraquiet.validate import ResidualTest
    from ultraquiet.validate.predict import Model
    from ultraquiet.values import Record

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
    from ultraquiet import files
    from ultraquiet import validate as room
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.values import PolynomialMatrix, PolynomialModel, StateSpace

    system = loaded(model, "validate", "identify")
    if not isinstance(system, PolynomialMatrix | PolynomialModel | StateSpace):
        raise InputError(f"validate: '{model}' holds a {type(system).__name__}, not a model.")
    data = files.read_record(record, rate, inputs, outputs, mapping, keep_clock=True)
    comparison = room.compare(system, data)
    residuals = _tested(system, data)
    one_step = residuals is not None and not residuals.simulated
    ahead = [room.compare(system, data, steps=k).fit_percent for k in STEPS] if one_step else []
    heads = [f"{k} ahead" for k in STEPS]
    grid = TextTable(("output", "simulated fit", *heads, "clipped", *P_VALUES), f"{model} on {record}")
    for i, channel in enumerate(data.sensors):
        steps = [f"{fit[i]:.2f} %" for fit in ahead] or ["-"] * len(STEPS)
        tests = ["-"] * len(P_VALUES)
        if residuals is not None:
            values = (residuals.whiteness_p[i], residuals.correlation_p[i].min(), residuals.feedback_p[i].min())
            tests = ["-" if np.isnan(p) else f"{p:.3g}" for p in values]
        grid.add(channel.name, f"{comparison.fit_percent[i]:.2f} %", *steps, str(comparison.clipped[i]), *tests)
    show = screen()
    show.table(grid)
    if residuals is not None:
        taken = "exact" if residuals.origin == "exact" else f"fitted to {residuals.origin}"
        show.say(f"p-values take the coefficients as {taken}.")
    advice = [str(each) for each in room.advise(data, None if isinstance(system, StateSpace) else system)]
    status = room.verdict(system, comparison, residuals)
    show.say(*advice, status)
    show.result({"status": status, "outputs": grid.records(), "advice": advice})
    finish(status)


def _tested(system: "Model", data: "Record") -> "ResidualTest | None":
    """Return the tests of what a model leaves; None of an unstable state space that is judged by its simulation."""
    from ultraquiet import validate as room
    from ultraquiet.validate.residuals import DEFAULT_LAGS
    from ultraquiet.validate.state_space_tests import by_simulation
    from ultraquiet.values import StateSpace

    if not isinstance(system, StateSpace):
        return room.residual_test(system, data)
    if by_simulation(system) and not system.is_stable():
        return None
    return room.state_space_test(system, data, max(1, min(DEFAULT_LAGS, data.samples // 10)))
