"""What the report says of what laws are for."""

from collections.abc import Iterator, Mapping

import numpy as np

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.shown.line import counted, figure_or, in_percent, loudness, opening, rounded
from ultraquiet.chart import Chart
from ultraquiet.pipeline.facts.mission import (
    CampaignCurves,
    CampaignFacts,
    CommissioningFacts,
    NoPayload,
    PayloadLoop,
)
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.plot.pages import campaign as pages
from ultraquiet.plot.pages.payload import Before, payload_chart
from ultraquiet.report import Section, Table
from ultraquiet.simulate.payload.wires import instrumented
from ultraquiet.values.channel import in_unit


def payload(result: StudyResult) -> Section:
    """What the payload feels of a shaken base, and of a force on itself."""
    table = result.study.payload
    assert table is not None
    low, high = table.band_hz
    loops = [(name, unit, loop) for name, of in result.payload.items() for unit, loop in of.facts.units.items()]
    tones = list(dict.fromkeys(f for *_, loop in loops if isinstance(loop, PayloadLoop) for f in loop.tones_db))
    columns = (
        "controller",
        "unit",
        f"{low:g}-{high:g} Hz rms",
        "least in any half hertz",
        *(f"{f} Hz" for f in tones),
        f"force by {table.force}" if table.force else "force",
    )
    rows = [(name, unit, *_row(loop, tones)) for name, unit, loop in loops]
    caption = (
        f"Payload while {table.shaker} shakes, all of {', '.join(table.sensors)} together, dB, positive is quieter"
    )
    figures = [chart for name in result.payload if _is_drawn(result, name) for chart in payload_charts(result, name)]
    return Section("Payload", list(_sentences(result)), [Table(caption, columns, rows)], figures)


def _row(loop: PayloadLoop | NoPayload, tones: list[str]) -> list[str]:
    if isinstance(loop, NoPayload):
        return ["-"] * (3 + len(tones))
    each = [figure_or(loop.tones_db.get(f)) for f in tones]
    force = figure_or(None if loop.force is None else loop.force.reduction_db)
    worst = f"{rounded(loop.worst_db)} at {loop.worst_hz:.3g} Hz" if np.isfinite(loop.worst_db) else "-"
    return [figure_or(loop.reduction_db), worst, *each, force]


def _sentences(result: StudyResult) -> Iterator[str]:
    """Say how it was measured, and what the law that the study is for does not do."""
    heard = {name: outcome.facts.units for name, outcome in result.payload.items()}
    loops = [loop for units in heard.values() for loop in units.values() if isinstance(loop, PayloadLoop)]
    if loops:
        yield _shaken(result, loops[0], {unit: loop for of in heard.values() for unit, loop in of.items()})
    for name, units in heard.items():
        if _is_drawn(result, name):
            found = {unit: loop for unit, loop in units.items() if isinstance(loop, PayloadLoop)}
            ran = {
                loop.through: [u for u, each in found.items() if each.through == loop.through]
                for loop in found.values()
            }
            yield from (f"On {' and '.join(on)} {name} ran as {through}." for through, on in ran.items())
            yield from _pushed(name, found)
    for name, units in heard.items():
        for unit, loop in units.items():
            if isinstance(loop, NoPayload):
                yield f"{name} on {unit}: {loop.status}"


def _shaken(result: StudyResult, one: PayloadLoop, loops: Mapping[str, PayloadLoop | NoPayload]) -> str:
    """Say what shakes the base, how loud, and what the payload does of it where nothing is controlled."""
    level = f"{one.level:.3g} {_unit_of(result, one.source)}".strip()
    low, high = one.band_hz
    moves = [
        f"{in_unit(loop.open_rms, loop.unit, 3)} RMS on {unit} (its sensors at rest say {loop.silent_rms:.2g})"
        for unit, loop in loops.items()
        if isinstance(loop, PayloadLoop)
    ]
    return (
        f"The base is shaken by {one.source}: noise of {level} RMS over {low:.4g}-{high:.4g} Hz. Without a law the "
        f"payload moves by {' and '.join(moves)}."
    )


def _unit_of(result: StudyResult, shaker: str) -> str:
    """Return the unit of the shaker's commands; empty where the bench does not tell."""
    try:
        wired = instrumented(result.bench, [shaker], "report")
    except UltraquietError:
        return ""
    return next((c.unit for c in wired.actuators if c.name == shaker), "")


def _pushed(name: str, loops: Mapping[str, PayloadLoop]) -> Iterator[str]:
    """Say where a force on the payload itself is reduced much less than a motion of its base."""
    spared = {unit: of.force for unit, of in loops.items() if of.force and of.force.reduction_db < of.reduction_db / 2}
    forces = [
        f"on {unit} it gets {loudness(force.reduction_db)}, {loudness(force.worst_db)} at {force.worst_hz:.3g} Hz"
        for unit, force in spared.items()
    ]
    if forces:
        source = next(iter(spared.values())).source
        yield (
            f"A force on the payload itself, by {source}, is not reduced by {name}: {'; '.join(forces)}. The law's "
            "sensors hear it where the payload stands on them, not where it moves."
        )


def _is_drawn(result: StudyResult, name: str) -> bool:
    """Tell whether a law is the one that the study is for; of all laws the first where it does not say."""
    asked = result.study.requirements
    return name == (next(iter(result.payload)) if asked is None else asked.law)


def payload_charts(result: StudyResult, name: str, stem: str = "payload") -> list[Chart]:
    """Return what the payload feels with a law and without it; nothing where it was not listened to."""
    table, outcome = result.study.payload, result.payload.get(name)
    if table is None or outcome is None or not outcome.facts.curves:
        return []
    units = {
        unit: Before(
            curves.f_hz,
            (curves.open_transmissibility, curves.closed_transmissibility),
            (curves.open_cumulative, curves.closed_cumulative),
        )
        for unit, curves in outcome.facts.curves.items()
    }
    loops = {unit: loop for unit, loop in outcome.facts.units.items() if isinstance(loop, PayloadLoop)}
    rms = next((loop.unit for loop in loops.values()), "1") or "1"
    ratio = "payload over base" if table.base else f"payload over {table.shaker}"
    low, high = table.band_hz
    told = "; ".join(
        f"{unit}: {in_unit(loop.open_rms, loop.unit, 3)} rms become {loop.closed_rms:.3g}, "
        f"{loudness(loop.reduction_db)} over {low:.4g}-{high:.4g} Hz, in the worst half hertz "
        f"{loudness(loop.worst_db)} at {loop.worst_hz:.3g} Hz"
        for unit, loop in loops.items()
    )
    return [payload_chart(stem, name, units, (ratio, "", rms), table.band_hz, f"{told}.")]


def campaign(facts: CampaignFacts, curves: CampaignCurves) -> Section:
    """The law on drawn benches: how figures spread, the worst cases, what drives them."""
    low, high = facts.band_hz
    labels = {"attenuation_db": f"worst direction over {low:g}-{high:g} Hz", "peak_db": "peak of S"}
    on = "their linear models" if facts.on == "truth" else "the benches themselves, measured"
    text = [
        f"{facts.law} on {counted(facts.benches, 'bench', 'benches')} drawn from the seed {facts.first_seed} on; "
        f"figures are of {on}.",
        opening(facts.status),
        "Rank correlation says what goes together; it proves no cause.",
    ]
    spread = ("0%", "5%", "50%", "95%", "100%")
    rows: list[list[str]] = []
    for group, stable, figures in facts.groups():
        for figure, label in labels.items():
            values = (figures[figure][share] for share in spread)
            rows.append([group, in_percent(stable, 1), label, *map(_of_a_case, values)])
    columns = ("unit", "stable", "figure, dB", "least", "5 %", "median", "95 %", "most")
    tables = [Table("Drawn benches", columns, rows), _worst(facts)]
    figures = {labels[name]: dict(getattr(curves, name)) for name in labels}
    drivers = {labels[name]: dict(found) for name, found in facts.drivers.items() if found}
    cases = {"median case": curves.median_case_db, "worst stable case": curves.worst_case_db}
    shown = {name: db for name, db in cases.items() if db is not None}
    pictures = [pages.spread_chart(figures, {}), *([pages.cases_chart(curves.f_hz, shown)] if shown else [])]
    pictures += [pages.drivers_chart(drivers)] if drivers else []
    return Section("Drawn benches", text, tables, pictures)


def _of_a_case(db: float) -> str:
    """Return a figure of a drawn bench; an unstable loop attenuates by -inf dB and peaks at inf."""
    return figure_or(db, otherwise="unstable" if np.isinf(db) else "-")


def _worst(facts: CampaignFacts) -> Table:
    rows = [
        (
            each.case,
            each.unit,
            _of_a_case(each.attenuation_db),
            _of_a_case(each.peak_db),
            each.cause or "-",
            each.replay,
        )
        for each in facts.worst
    ]
    columns = ("case", "unit", "attenuation, dB", "peak, dB", "pulls hardest", "evaluate it again")
    return Table("The worst cases", columns, rows)


def commissioning(facts: CommissioningFacts) -> Section:
    """How the law came on: at each gain the margins of both ends, measured without a model."""
    text = [
        f"{facts.law} came on at rising shares of its gain. Margins are those of all channels at once, from sines "
        f"injected while it ran; below {facts.margin:g} it is taken off.",
        *(f"{unit}: {found.status}" for unit, found in facts.units.items()),
    ]
    rows = [
        (
            unit,
            in_percent(step.gain),
            ", ".join(f"{end} {figure_or(alpha, 2)} at {step.disk_hz[end]:.3g} Hz" for end, alpha in step.disk.items()),
            ", ".join(f"{end} {figure_or(db)}" for end, db in step.peak_db.items()),
            figure_or(step.reduction_db),
            figure_or(step.next_disk, 2),
        )
        for unit, found in facts.units.items()
        for step in found.steps
    ]
    columns = ("unit", "gain", "disk margin", "peak of S, dB, noise counted", "band, dB", "foreseen for the next")
    return Section("How the law came on", text, [Table("Steps of the gain", columns, rows)])
