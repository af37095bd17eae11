"""`ultraquiet demo`, `run` and `report`: whole studies."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ultraquiet._base.constraints import whole
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.progress import bars

if TYPE_CHECKING:
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.pipeline import Study
    from ultraquiet.pipeline.summary import Summary

Out = Annotated[Path | None, typer.Option("--out", help="Folder for everything the study leaves.")]
Again = Annotated[bool, typer.Option("--record-again", help="Set the records that are there aside and measure anew.")]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer structures, orders, units and limits; under two minutes.")]


def demo(
    out: Out = None,
    quick: Quick = False,
    seed: Annotated[int | None, typer.Option(help="Where test signals and sensor noise start.")] = None,
    record_again: Again = False,
) -> None:
    """Run the embedded SUITE study: excite, identify, validate, design, close the loop, generate code, report."""
    from ultraquiet.pipeline import packaged_study, quick_study

    study = packaged_study("suite")
    if seed is not None:
        head = study.study.model_copy(update={"seed": whole("demo", "seed", seed, 0)})
        study = study.model_copy(update={"study": head})
    _walk(quick_study(study) if quick else study, Path("ultraquiet-demo") if out is None else out, None, record_again)


def run(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    out: Out = None,
    quick: Quick = False,
    record_again: Again = False,
) -> None:
    """Run a study file; finished stages are reused."""
    from ultraquiet.pipeline import load_study, quick_study

    loaded = load_study(study)
    _walk(quick_study(loaded) if quick else loaded, out or study.with_suffix(""), study.parent, record_again)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of a study that has run.")],
    compare: Annotated[Path | None, typer.Option(help="Folder of another study to set beside it.")] = None,
) -> None:
    """Write the report of a study again from what its folder holds; stages that are missing are computed."""
    from ultraquiet.pipeline import reload_study

    _walk(reload_study(folder), folder, folder, compare=compare)


def _walk(
    study: "Study", folder: Path, beside: Path | None, record_again: bool = False, compare: Path | None = None
) -> None:
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.pipeline import walk

    with bars() as console:
        summary = walk(study, folder, beside=beside, say=console.print, record_again=record_again, compare=compare)
    show = screen()
    if summary.closed_loop:
        show.table(_table(summary))
        show.say(*_louder(summary))
    show.say(f"report: {folder / 'report.html'}", f"numbers: {folder / 'summary.json'}")
    if summary.requirements is not None:
        show.say(f"requirements of {summary.requirements.law}:")
        show.say(*(f"  {judged.sentence}" for judged in summary.requirements.judged))
    show.say(*(f"failed: {sentence}" for sentence in summary.failures))
    if show.as_json:
        show.result(json.loads((folder / "summary.json").read_text(encoding="utf-8")))
    finish(summary)


def _louder(summary: "Summary") -> list[str]:
    """Return a sentence for every law that may be ok and leaves a direction of its band louder than it was."""
    from ultraquiet._base.shown.line import loudness
    from ultraquiet.pipeline.facts.loops import StableLoop, of_the_bench

    loops = [(name, unit, loop) for name, units in summary.closed_loop.items() for unit, loop in units.items()]
    return [
        f"{name} is not quieter in every direction on {of_the_bench(unit)}: over {loop.band_hz[0]:.4g}-"
        f"{loop.band_hz[1]:.4g} Hz the worst is {loudness(loop.worst_direction_band_db)}"
        for name, unit, loop in loops
        if isinstance(loop, StableLoop) and loop.worst_direction_band_db <= 0
    ]


def _table(summary: "Summary") -> "TextTable":
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop

    loops = [loop for units in summary.closed_loop.values() for loop in units.values()]
    tones_hz = list(dict.fromkeys(f for loop in loops if isinstance(loop, StableLoop) for f in loop.tones))
    bands_hz = dict.fromkeys(loop.band_hz for loop in loops if isinstance(loop, StableLoop))
    over = "".join(f", {low:.4g}-{high:.4g} Hz" for low, high in bands_hz)
    at_tones = "worst channel at tones, " if tones_hz else ""
    title = f"reduction on the bench, dB: {at_tones}worst direction over the band{over}; peak is amplification"
    grid = TextTable(("controller", "unit", "states", *(f"{f} Hz" for f in tones_hz), "band", "peak"), title)
    for name, units in summary.closed_loop.items():
        states = str(summary.design[name].states)
        for unit, loop in units.items():
            if isinstance(loop, UnstableLoop):
                grid.add(name, unit, states, *[loop.word, *["-"] * (len(tones_hz) + 1)])
                continue
            tones = [loop.tones[f].reduction_db if f in loop.tones else None for f in tones_hz]
            figures = [*tones, loop.worst_direction_band_db, loop.peak_amplification_db]
            grid.add(name, unit, states, *("-" if v is None else f"{v:.1f}" for v in figures))
    return grid
