"""`ultraquiet experiment`: an experiment list on a bench."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet.cli.progress import bars


def experiment(
    commands: Annotated[Path, typer.Argument(metavar="LIST", help="The experiment list (TOML).")],
    out: Annotated[Path | None, typer.Option(help="Folder for the records; default: beside the list.")] = None,
) -> None:
    """Check an experiment list whole, then execute it in order; finished records are never written over."""
    from ultraquiet import experiments

    listed = experiments.load(commands)
    folder = out or commands.with_suffix("")
    with bars() as console:
        records = experiments.run(listed, folder)
    console.print(f"{len(records)} records in {folder}", highlight=False, soft_wrap=True)
