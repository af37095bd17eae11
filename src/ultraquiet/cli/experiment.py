"""`ultraquiet experiment`: an experiment list on a bench."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet.cli.progress import bars


def experiment(
    commands: Annotated[Path, typer.Argument(metavar="LIST", help="The experiment list (TOML).")],
    out: Annotated[Path | None, typer.Option(help="Folder for the records; default: the list's name.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where a run was broken off.")] = False,
    repeat: Annotated[
        list[str] | None, typer.Option(help="A measurement that was begun, left no record, and may be excited again.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Write over records that are there.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the list and say how long it takes.")] = False,
) -> None:
    """Check an experiment list whole, then execute it in order; finished records are never written over unasked."""
    from rich.console import Console

    from ultraquiet import experiments

    listed = experiments.load(commands)
    told = Console()
    if dry_run:
        told.print(f"{len(listed.measurements)} records, {listed.duration_s:.1f} s on the bench", highlight=False)
        return
    folder = out or Path(commands.stem)
    with bars():
        records = experiments.run(listed, folder, resume=resume, repeat=repeat or (), overwrite=overwrite)
    told.print(f"{len(records)} records in {folder}", highlight=False, soft_wrap=True)
