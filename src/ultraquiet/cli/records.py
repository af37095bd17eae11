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
    entries = experiments.search(folder, what, bench, since, status, listed)
    if as_json:
        sys.stdout.write(json.dumps([asdict(entry) for entry in entries], indent=1) + "\n")
        return
    console = Console(highlight=False)
    if entries:
        console.print(_table(entries))
    console.print("1 run" if len(entries) == 1 else f"{len(entries)} runs", soft_wrap=True)


def _table(entries: tuple["Entry", ...]) -> "Table":
    from datetime import datetime

    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Column, Table

    # In a narrow terminal words are folded, never cut; dates and counts stay whole.
    words = {name: Column(name, overflow="fold") for name in ("run", "bench, list", "sent", "file")}
    whole = {name: Column(name, no_wrap=True) for name in ("when", "status")}
    counts = (Column(name, no_wrap=True, justify="right") for name in ("samples", "clipped", "late", "°C"))
    table = Table(
        whole["when"], words["run"], whole["status"], words["bench, list"], words["sent"], *counts, words["file"],
        box=SIMPLE_HEAD, padding=0, pad_edge=False, collapse_padding=True,
    )  # fmt: skip
    for e in entries:
        when = datetime.fromisoformat(e.when).astimezone().strftime("%Y-%m-%d\n%H:%M:%S") if e.when else "-"
        sent = [f"{e.signal} {e.actuators}".strip() or "-"]
        sent += [f"d: {e.disturbance}"] * bool(e.disturbance) + [f"K: {e.controller}"] * bool(e.controller)
        temperature = "-" if e.temperature_c is None else f"{e.temperature_c:.1f}"
        cells = ("\n".join(filter(None, lines)) for lines in ((e.name, e.comment), (e.bench, e.list), sent))
        run, bench, signals = map(escape, cells)
        numbers = (str(e.samples), str(e.clipped), str(e.overruns), temperature)
        table.add_row(when, run, e.status, bench, signals, *numbers, escape(e.file) or "-")
    return table
