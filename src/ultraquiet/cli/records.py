"""`ultraquiet records`: the catalogue of runs, searched."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from ultraquiet.experiments import Entry


def records(
    folder: Annotated[Path, typer.Argument(help="Where to look; folders inside it count too.")] = Path(),
    what: Annotated[str, typer.Option(help="A part of name, signal, controller, comment or file.")] = "",
    bench: Annotated[str, typer.Option(help="A part of the bench's name or settings.")] = "",
    since: Annotated[str, typer.Option(help="Only runs from this date or time on (ISO 8601).")] = "",
    status: Annotated[str, typer.Option(help="DONE, ABORTED, NOT-STARTED or RUNNING.")] = "",
    listed: Annotated[str, typer.Option("--list", help="A part of the list's title, or of its hash.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="All that is known, as JSON.")] = False,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Make the catalogue anew from the files.")] = False,
) -> None:
    """Show what was measured below a folder: when, on which bench, by which list, and how it ended."""
    import json
    import sys
    from dataclasses import asdict

    from rich.console import Console

    from ultraquiet import experiments

    if rebuild:
        experiments.rebuild(folder)
    found = experiments.search(folder, what, bench, since, status, listed)
    if as_json:
        sys.stdout.write(json.dumps([asdict(entry) for entry in found], indent=1) + "\n")
        return
    told = Console(highlight=False)
    if found:
        told.print(_table(found))
    told.print(f"{len(found)} runs", soft_wrap=True)


def _table(found: tuple["Entry", ...]) -> "Table":
    from datetime import datetime

    from rich.table import Table

    table = Table("when", "name", "status", "bench", "list", "excitation", "samples", "clipped", "late", "T", "file")
    for e in found:
        when = datetime.fromisoformat(e.when).astimezone().strftime("%Y-%m-%d %H:%M:%S") if e.when else "-"
        excitation = f"{e.signal} {e.actuators}".strip() or "-"
        extras = [f"d: {e.disturbance}"] * bool(e.disturbance) + [f"K: {e.controller}"] * bool(e.controller)
        warm = "-" if e.temperature_c is None else f"{e.temperature_c:.1f}"
        counts = (str(e.samples), str(e.clipped), str(e.overruns), warm)
        name = f"{e.name}\n{e.comment}".strip()
        table.add_row(when, name, e.status, e.bench, e.list, "\n".join([excitation, *extras]), *counts, e.file or "-")
    return table
