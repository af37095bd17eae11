"""`ultraquiet records`: the catalogue of runs, searched."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ultraquiet._base.shown.line import counted

if TYPE_CHECKING:
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.experiments import Entry


def records(
    folder: Annotated[Path, typer.Argument(help="Where to look; folders inside it count too.")] = Path(),
    what: Annotated[str, typer.Option(help="A part of name, signal, controller, comment or file.")] = "",
    bench: Annotated[str, typer.Option(help="A part of the bench's name or settings.")] = "",
    since: Annotated[str, typer.Option(help="Only runs from this date or time on (ISO 8601).")] = "",
    status: Annotated[str, typer.Option(help="DONE, ABORTED, NOT-STARTED or RUNNING.")] = "",
    listed: Annotated[str, typer.Option("--list", help="A part of the list's title, or of its hash.")] = "",
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Make the catalogue anew from the files.")] = False,
) -> None:
    """Show what was measured below a folder: when, on which bench, by which list, and how it ended."""
    from ultraquiet import experiments
    from ultraquiet.cli.output.screen import screen

    if rebuild:
        experiments.rebuild(folder)
    entries = experiments.search(folder, what, bench, since, status, listed)
    show = screen()
    if entries:
        show.table(_table(entries))
    show.say(counted(len(entries), "run"))
    show.result(entries)


def _table(entries: tuple["Entry", ...]) -> "TextTable":
    from datetime import datetime

    from ultraquiet.cli.output.text_table import TextTable

    heads = ("when", "run", "status", "bench, list", "sent", "samples", "clipped", "late", "°C", "file")
    grid = TextTable(heads)
    for e in entries:
        when = datetime.fromisoformat(e.when).astimezone().strftime("%Y-%m-%d %H:%M:%S") if e.when else "-"
        sent = [f"{e.signal} {e.actuators}".strip() or "-"]
        sent += [f"d: {e.disturbance}"] * bool(e.disturbance) + [f"K: {e.controller}"] * bool(e.controller)
        temperature = "-" if e.temperature_c is None else f"{e.temperature_c:.1f}"
        cells = ("\n".join(filter(None, lines)) for lines in ((e.name, e.comment), (e.bench, e.list), sent))
        run, bench, signals = cells
        numbers = (e.samples, e.clipped, e.overruns, temperature)
        grid.add(when, run, e.status, bench, signals, *numbers, e.file or "-")
    return grid
