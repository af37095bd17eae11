"""`ultraquiet inspect`: what a file of measurements holds, and what is wrong with it."""

from pathlib import Path
from typing import Annotated

import typer


def inspect(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A file of any format; its suffix says which.")],
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", "--rate", help="Samples per second, when the file does not say.")
    ] = None,
) -> None:
    """Show channels, units, rate, duration, levels, clipped samples and gaps."""
    from ultraquiet import files
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.cli.output.text_table import TextTable

    survey = files.survey(path, rate_hz, keep_clock=True)
    clock = "rate unknown" if survey.rate_hz is None else f"{survey.rate_hz:.10g} Hz"
    length = "" if survey.duration_s is None else f", {survey.duration_s:g} s"
    heads = ("channel", "role", "unit", "samples", "mean", "rms", "peak", "clipped", "missing")
    grid = TextTable(heads, f"{path.name}: {survey.format}, {survey.size}, {clock}{length}")
    for c in survey.channels:
        levels = (f"{level:.4g}" for level in (c.mean, c.rms, c.peak))
        grid.add(c.name, c.role or "-", c.unit, c.samples, *levels, c.clipped, c.missing)
    show = screen()
    show.table(grid)
    show.say(*(f"note: {note}" for note in survey.notes))
    show.result(survey)
