"""The campaign of a study: its law on drawn benches, table and summary in the study's folder."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import simulate
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import counted, in_percent, loudness
from ultraquiet.files import write_bytes
from ultraquiet.identify import Rational
from ultraquiet.pipeline.facts.mission import CampaignCurves, CampaignFacts, MeasuredCases, WorstCase
from ultraquiet.pipeline.facts.typed import finite, to_plain
from ultraquiet.pipeline.preflight import LoopPlan, as_unit
from ultraquiet.pipeline.study import Study
from ultraquiet.pipeline.tables.mission import CampaignTable, CommissionTable
from ultraquiet.simulate.campaigns import findings
from ultraquiet.simulate.campaigns.evaluation import DRAWN, Row
from ultraquiet.simulate.campaigns.run import write_table
from ultraquiet.values import StateSpace

TABLE, SUMMARY, SEALED = "campaign.parquet", "campaign.json", "campaign/results.jsonl"
DRAWN_LINES = 400


CampaignOutcome = tuple[CampaignFacts, CampaignCurves]


@dataclass(frozen=True)
class How:
    """Where a campaign runs: `workers` processes here, or on a Dask `cluster`; `replay` is how a case is named.

    `resume` None goes on with results that are there if they are this campaign's, and begins anew else.
    """

    workers: int | None = None
    cluster: str | None = None
    resume: bool | None = True
    replay: str = "ultraquiet campaign STUDY.toml"


def law_of(study: Study, table: CampaignTable | CommissionTable) -> str:
    """Return the name of the law that a campaign or a commissioning is about.

    Raises:
        InputError: the study designs no such law.
    """
    asked = study.requirements
    name = table.law or (next(iter(study.controllers)) if asked is None else asked.law)
    if name not in study.controllers:
        raise InputError(
            f"campaign.law: there is no law '{name}' among the controllers {', '.join(study.controllers)}."
        )
    return name


def defined(
    study: Study, bench: Any, law: StateSpace, plan: LoopPlan, table: CampaignTable, bench_key: Any
) -> simulate.Campaign:
    """Return the campaign that a study names; `bench_key` is what defines its bench.

    Raises:
        InputError: the bench cannot be drawn, or has no linear model where one is asked for.
    """
    asked = study.requirements
    band_hz = plan.band_hz if asked is None or asked.band_hz is None else asked.band_hz
    units = tuple((unit, as_unit(bench, unit)) for unit in plan.units)
    for _, each in units:
        simulate.drawn_bench(each, table.first_seed)
    tuning = _tuning(study, table)
    return simulate.Campaign(units, law, band_hz, table.on, table.first_seed, tuning, table.measured, bench_key)


def _tuning(study: Study, table: CampaignTable) -> simulate.Tuning | None:
    if not table.tune:
        return None
    identify = study.plant.make("identify")
    if not isinstance(identify, Rational):
        raise InputError("campaign: 'tune' fits responses; give [plant] the method \"rational\".")
    return simulate.Tuning(study.controllers[law_of(study, table)].design.make("design"), identify)


def conducted(campaign: simulate.Campaign, name: str, table: CampaignTable, folder: Path, how: How) -> CampaignOutcome:
    """Run a campaign, or what is left of it, and leave its table and summary in a folder."""
    sealed = folder / SEALED
    resume = simulate.is_of(campaign, sealed) if how.resume is None else how.resume
    rows = simulate.run_campaign(
        campaign, table.benches, sealed, workers=how.workers, cluster=how.cluster, resume=resume
    )
    write_table(rows, folder / TABLE)
    facts = _facts(campaign, name, table, rows, how)
    write_bytes(folder / SUMMARY, json.dumps(finite(to_plain(facts)), indent=1).encode())
    return facts, _curves(campaign, rows, facts.worst)


def _facts(
    campaign: simulate.Campaign, name: str, table: CampaignTable, rows: Sequence[Row], how: How
) -> CampaignFacts:
    share, interval = findings.stable_share(rows)
    by_unit = {unit: [row for row in rows if row["unit"] == unit] for unit, _ in campaign.units}
    return CampaignFacts(
        law=name,
        on=campaign.on,
        benches=len(rows),
        first_seed=campaign.first_seed,
        band_hz=campaign.band_hz,
        stable=sum(bool(row["stable"]) for row in rows),
        stable_share=share,
        stable_interval=interval,
        attenuation_db=findings.spread(rows, "attenuation_db"),
        peak_db=findings.spread(rows, "peak_db"),
        by_unit={
            unit: {
                "stable_share": {"share": findings.stable_share(own)[0]},
                **{figure: findings.spread(own, figure) for figure in findings.FIGURES},
            }
            for unit, own in by_unit.items()
            if own
        },
        drivers={
            figure: {d.parameter.removeprefix(DRAWN): d.correlation for d in findings.drivers(rows, figure)}
            for figure in findings.FIGURES
        },
        worst=_worst(rows, table.keep, how),
        lines_missing=sum(int(row["lines_missing"]) for row in rows),
        measured=_measured(rows),
        campaign=campaign.digest,
        status=_status(rows, share, interval),
    )


def _measured(rows: Sequence[Row]) -> MeasuredCases | None:
    heard = findings.measured(rows)
    if not heard:
        return None
    spreads = {figure: findings.spread(heard, figure) for figure in findings.FIGURES}
    return MeasuredCases(benches=len(heard), stable=sum(bool(row["stable"]) for row in heard), **spreads)


def _worst(rows: Sequence[Row], keep: int, how: How) -> tuple[WorstCase, ...]:
    worst = findings.worst_cases(rows, keep)
    found: list[WorstCase] = []
    for row, cause in zip(worst, findings.causes(rows, worst, "peak_db"), strict=True):
        fields = {key: row[key] for key in ("case", "seed", "unit", "stable", "attenuation_db", "peak_db", "status")}
        said = None
        if cause.parameter is not None:
            said = f"{cause.parameter.removeprefix(DRAWN)}, {cause.deviation:+.1f} standard deviations"
        found.append(WorstCase(**fields, cause=said, replay=f"{how.replay} --case {row['case']}"))
    return tuple(found)


def _status(rows: Sequence[Row], share: float, interval: tuple[float, float]) -> str:
    stable = sum(bool(row["stable"]) for row in rows)
    depth, peak = (findings.spread(rows, figure) for figure in ("attenuation_db", "peak_db"))
    word = "ok" if share == 1.0 else "unstable"
    drawn = counted(len(rows), "drawn bench", "drawn benches")
    return (
        f"{word}: The loop is stable on {stable} of {drawn} (95 % sure of {in_percent(interval[0], 1)}); "
        f"95 % of them get the worst direction {_at_least(depth['5%'])} and peak {_at_most(peak['95%'])}."
    )


def _at_least(attenuation_db: float) -> str:
    """Return what so many benches reach at least.

    >>> _at_least(12.0), _at_least(-3.0), _at_least(-0.01)
    ('quieter by 12.0 dB or more', 'louder by 3.0 dB or less', 'no louder')
    """
    if not np.isfinite(attenuation_db):
        return "louder without bound"
    if loudness(attenuation_db) == loudness(0.0):
        return "no louder"
    return f"{loudness(attenuation_db)} or {'more' if attenuation_db > 0 else 'less'}"


def _at_most(peak_db: float) -> str:
    """Return how far so many benches peak.

    >>> _at_most(6.0), _at_most(float("inf"))
    ('at no more than 6.0 dB', 'without bound')
    """
    return f"at no more than {peak_db:.1f} dB" if np.isfinite(peak_db) else "without bound"


def _curves(campaign: simulate.Campaign, rows: Sequence[Row], worst: Sequence[WorstCase]) -> CampaignCurves:
    """Return what is drawn; the worst direction is of the worst case that is stable, and of the middle one."""
    units = [unit for unit, _ in campaign.units]
    stable = sorted((row for row in rows if row["stable"]), key=lambda row: (float(row["peak_db"]), row["case"]))
    f = np.geomspace(campaign.band_hz[0] / 10, campaign.units[0][1].rate_hz / 2, DRAWN_LINES, endpoint=False)
    two: list[Any] = [None, None]
    if stable:
        for k, row in enumerate((stable[len(stable) // 2], stable[-1])):
            size = campaign.worst_direction(row["case"], f)
            two[k] = None if size is None else 20 * np.log10(size)

    def by_unit(figure: str) -> dict[str, Any]:
        return {unit: [float(row[figure]) for row in rows if row["unit"] == unit and row["stable"]] for unit in units}

    return CampaignCurves(
        attenuation_db=by_unit("attenuation_db"),
        peak_db=by_unit("peak_db"),
        f_hz=f,
        median_case_db=two[0],
        worst_case_db=two[1],
    )
