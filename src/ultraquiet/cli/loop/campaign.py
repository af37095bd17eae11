"""`ultraquiet campaign`: the law of a study on benches drawn afresh."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ultraquiet._base.shown.line import command, counted
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.progress import bars

if TYPE_CHECKING:
    from ultraquiet.cli.output.text_table import TextTable
    from ultraquiet.pipeline.facts.mission import CampaignFacts


def campaign(
    study: Annotated[Path, typer.Argument(help="The study file (TOML), or the folder of a study that has run.")],
    benches: Annotated[
        int | None, typer.Option("--benches", min=1, help="How many are drawn; default: the study's, or 50.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one a core.")] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="local|ADDRESS", help="On a Dask cluster: one made here, or a scheduler's."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the results that are there.")] = False,
    case: Annotated[int | None, typer.Option("--case", min=0, help="Evaluate one case again, no other.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the study; default: beside its file.")] = None,
) -> None:
    """Draw benches, close the study's law on each, and say how its figures spread and what drives them."""
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.deploy.figures import figure_text
    from ultraquiet.pipeline import conduct, load_study, one_case, reload_study
    from ultraquiet.pipeline.mission.campaign import How
    from ultraquiet.values import Status, StatusWord

    ran = study.is_dir()
    loaded, beside = (reload_study(study), study) if ran else (load_study(study), study.parent)
    folder = out or (study if ran else study.with_suffix(""))
    show = screen()
    if case is not None:
        with bars() as console:
            row = one_case(loaded, folder, beside, console.print, case)
        show.say(*(f"{_said(name)}: {figure_text(value)}" for name, value in row.items()))
        show.result(row)
        finish(Status(StatusWord.OK if row["stable"] else StatusWord.UNSTABLE, row["status"].partition(": ")[2]))
        return
    how = How(
        workers, cluster, resume, command("ultraquiet", "campaign", study, *(() if out is None else ("--out", out)))
    )
    with bars() as console:
        facts = conduct(loaded, folder, beside, console.print, how, benches)
    show.table(_table(facts))
    show.say(facts.status, *(f"worst: case {each.case}, {each.unit}: {each.replay}" for each in facts.worst))
    show.say(f"table: {folder / 'campaign.parquet'}", f"summary: {folder / 'campaign.json'}")
    show.result(facts)
    word, _, sentence = facts.status.partition(": ")
    finish(Status(StatusWord(word), sentence))


def _said(name: str) -> str:
    """Return what a figure of a case is called for a reader.

    >>> _said("attenuation_db"), _said("drawn: gain_spread")
    ('attenuation of the worst direction (dB)', 'drawn: gain spread')
    """
    known = {"attenuation_db": "attenuation of the worst direction (dB)", "peak_db": "peak of S (dB)"}
    bare = name.removesuffix("_db").removesuffix("_hz").replace("_", " ")
    unit = " (dB)" if name.endswith("_db") else " (Hz)" if name.endswith("_hz") else ""
    return known.get(name, f"{bare}{unit}")


def _table(facts: "CampaignFacts") -> "TextTable":
    from ultraquiet.cli.output.text_table import TextTable

    low, high = facts.band_hz
    benches = counted(facts.benches, "drawn bench", "drawn benches")
    title = f"{facts.law} on {benches} ({facts.on}), dB; worst direction over {low:g}-{high:g} Hz"
    grid = TextTable(("unit", "stable", "figure", *facts.attenuation_db), title)
    for group, share, figures in facts.groups():
        for name, label in (("attenuation_db", "attenuation"), ("peak_db", "peak")):
            grid.add(group, f"{share:.1%}", label, *(f"{value:.1f}" for value in figures[name].values()))
    return grid
