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
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    from ultraquiet import files

    survey = files.survey(path, rate_hz)
    console = Console()
    clock = "rate unknown" if survey.rate_hz is None else f"{survey.rate_hz:.10g} Hz"
    length = "" if survey.duration_s is None else f", {survey.duration_s:g} s"
    numbers = ("samples", "mean", "rms", "peak", "clipped", "NaN")
    table = Table(
        Column("channel", overflow="fold"),
        *(Column(name, no_wrap=True) for name in ("role", "unit")),
        *(Column(name, no_wrap=True, justify="right") for name in numbers),
        title=escape(f"{path.name}: {survey.format}, {survey.size}, {clock}{length}"),
        box=SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        collapse_padding=True,
    )
    for c in survey.channels:
        levels = (f"{level:.4g}" for level in (c.mean, c.rms, c.peak))
        table.add_row(
            escape(c.name), c.role or "-", escape(c.unit), str(c.samples), *levels, str(c.clipped), str(c.missing)
        )
    console.print(table)
    for note in survey.notes:
        console.print(f"note: {note}", highlight=False, soft_wrap=True, markup=False)
