"""`ultraquiet experiment`: an experiment list on a bench."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from ultraquiet.experiments import DryRun, DryStep, State
    from ultraquiet.experiments.dry import Sent


def experiment(
    commands: Annotated[Path, typer.Argument(metavar="LIST", help="The experiment list (TOML).")],
    out: Annotated[Path | None, typer.Option(help="Folder for the records; default: the list's name.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where a run was broken off.")] = False,
    repeat: Annotated[
        list[str] | None, typer.Option(help="A measurement that was begun, left no record, and may be excited again.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Write over records that are there.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the list and show what it would do.")] = False,
) -> None:
    """Check an experiment list whole, then execute it in order; finished records are never written over unasked.

    Ctrl-C brings the bench to zero, keeps what was measured, and says where each measurement stands (exit code 130).
    """
    from rich.console import Console

    from ultraquiet import experiments
    from ultraquiet._base.errors import UltraquietError
    from ultraquiet.cli.exits.codes import ExitCode
    from ultraquiet.cli.experiment.halt import halting
    from ultraquiet.cli.experiment.watch import watching

    listed = experiments.load(commands)
    console = Console(highlight=False)
    if dry_run:
        _show(console, experiments.dry_run(listed))
        return
    folder = out or Path(commands.stem)
    try:
        with halting() as halt, watching(halt.requested) as onlooker:
            records = experiments.run(
                listed,
                folder,
                resume=resume,
                repeat=repeat or (),
                overwrite=overwrite,
                stop=halt.requested,
                onlooker=onlooker,
            )
    except UltraquietError as error:
        states: Sequence[State] = ()
        with suppress(UltraquietError):  # a folder that cannot be looked into is what the error is about
            states = experiments.states(listed.measurements, folder)
        if any(state.status != "NOT STARTED" for state in states):
            console.print(_states(states))
        if isinstance(error, experiments.StoppedError) and error.asked:
            raise typer.Exit(ExitCode.INTERRUPTED) from error
        raise
    warned = f", {_counted(onlooker.warned, 'warning')}" if onlooker.warned else ""
    console.print(f"{_counted(len(records), 'record')} in {folder}{warned}", soft_wrap=True)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _states(states: Sequence["State"]) -> "Table":
    from rich.table import Table

    colours = {"DONE": "green", "ABORTED": "red", "NOT STARTED": "dim"}
    table = Table("measurement", "state", "file")
    for state in states:
        table.add_row(state.name, f"[{colours[state.status]}]{state.status}", state.file)
    return table


def _show(console: object, planned: "DryRun") -> None:
    from rich.console import Console
    from rich.table import Table

    assert isinstance(console, Console)
    table = Table("line", "begins", "lasts", "step", "excitation", "disturbance", "controller", title="nothing moves")
    for step in planned.steps:
        table.add_row(
            str(step.line),
            f"{step.begins_s:.2f} s",
            f"{step.lasts_s:.2f} s",
            f"{step.do} {step.name}".strip(),
            _sent(step.excitation),
            _sent(step.disturbance),
            _controller(step),
        )
    console.print(table)
    count = sum(step.samples > 0 for step in planned.steps)
    kind = "in real time" if planned.real_time else "simulated: waits are skipped, the rest takes what it takes"
    waits = f", {planned.waits_s:.1f} s of them waits" if planned.waits_s else ""
    disk = f"at most {planned.disk_bytes / 1e6:.1f} MB on the disk"
    console.print(
        f"{_counted(count, 'record')}, {planned.duration_s:.1f} s on the bench{waits} ({kind}), {disk}", soft_wrap=True
    )


def _controller(step: "DryStep") -> str:
    return (step.controller or "off") if step.samples else ""


def _sent(signals: Sequence["Sent"]) -> str:
    """Return one line a signal; signals alike but for their channel share it."""
    lines: dict[str, list[str]] = {}
    for s in signals:
        low, high = s.band_hz
        description = f"{s.what}, peak {s.peak:.3g} {s.unit}, RMS {s.rms:.2g} {s.unit}, {low:.4g}-{high:.4g} Hz"
        lines.setdefault(description, []).append(s.actuator)
    return "\n".join(f"{', '.join(channels)}: {description}" for description, channels in lines.items())
