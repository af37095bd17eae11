"""`ultraquiet experiment`: an experiment list on a bench."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ultraquiet.cli.output.text_table import TextTable
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
    from ultraquiet import experiments
    from ultraquiet._base.errors import UltraquietError
    from ultraquiet.cli.exits.codes import ExitCode
    from ultraquiet.cli.experiment.halt import halting
    from ultraquiet.cli.experiment.watch import watching
    from ultraquiet.cli.output.screen import screen

    listed = experiments.load(commands)
    show = screen()
    for sentence in listed.said:
        show.say(sentence)
    if dry_run:
        _show(experiments.dry_run(listed))
        return
    folder = out or Path(commands.stem)
    try:
        with halting(ends_program=True) as halt, watching(halt.requested, show.quiet) as onlooker:
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
            show.table(_states(states))
            show.result({"measurements": states})
        if isinstance(error, experiments.StoppedError) and error.asked:
            raise typer.Exit(ExitCode.INTERRUPTED) from error
        raise
    warned = f", {_counted(onlooker.warned, 'warning')}" if onlooker.warned else ""
    show.say(f"{_counted(len(records), 'record')} in {folder}{warned}")
    show.result({"records": len(records), "folder": folder, "warnings": onlooker.warned})


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _states(states: Sequence["State"]) -> "TextTable":
    from ultraquiet.cli.output.text_table import TextTable

    grid = TextTable(("measurement", "state", "file"))
    for state in states:
        grid.add(state.name, state.status, state.file)
    return grid


def _show(planned: "DryRun") -> None:
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.cli.output.text_table import TextTable

    heads = ("line", "begins", "lasts", "step", "excitation", "disturbance", "controller")
    grid = TextTable(heads, "nothing moves")
    for step in planned.steps:
        grid.add(
            step.line,
            f"{step.begins_s:.2f} s",
            f"{step.lasts_s:.2f} s",
            f"{step.do} {step.name}".strip(),
            _sent(step.excitation),
            _sent(step.disturbance),
            _controller(step),
        )
    show = screen()
    show.table(grid)
    count = sum(step.samples > 0 for step in planned.steps)
    kind = "in real time" if planned.real_time else "simulated: waits are skipped, the rest takes what it takes"
    waits = f", {planned.waits_s:.1f} s of them waits" if planned.waits_s else ""
    disk = f"at most {planned.disk_bytes / 1e6:.1f} MB on the disk"
    show.say(f"{_counted(count, 'record')}, {planned.duration_s:.1f} s on the bench{waits} ({kind}), {disk}")
    show.result(planned)


def _controller(step: "DryStep") -> str:
    return (step.controller or "off") if step.samples else ""


def _sent(signals: Sequence["Sent"]) -> str:
    """Return one line a signal; signals alike but for their channel share it."""
    from ultraquiet.values.channel import in_unit

    lines: dict[str, list[str]] = {}
    for s in signals:
        low, high = s.band_hz
        sizes = f"peak {in_unit(s.peak, s.unit, 3)}, RMS {in_unit(s.rms, s.unit, 2)}"
        description = f"{s.what}, {sizes}, {low:.4g}-{high:.4g} Hz"
        lines.setdefault(description, []).append(s.actuator)
    return "\n".join(f"{', '.join(channels)}: {description}" for description, channels in lines.items())
