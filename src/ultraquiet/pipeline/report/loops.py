"""What the report says of controllers and loops."""

from collections.abc import Iterator

import numpy as np

from ultraquiet._base.shown.line import counted, hertz, loudness, opening, rounded
from ultraquiet.pipeline.facts.limits import DesignLimit
from ultraquiet.pipeline.facts.loops import DesignFacts, StableLoop, UnstableLoop, of_the_bench
from ultraquiet.pipeline.facts.requirements import RequirementsFacts
from ultraquiet.pipeline.report import laws
from ultraquiet.pipeline.report.records import noted, span
from ultraquiet.pipeline.requirements import in_short
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.plot.pages import bench
from ultraquiet.plot.pages.waterfall import waterfall
from ultraquiet.report import Picture, Section, Table, Verdict

# A cost this small beside what the paper's T <= 1 row alone would weigh says that the optimum is to do nothing.
IDLE = 1e-3
# A response is drawn at the tone that the law attenuates most, if it attenuates at all.
DRAWN_ABOVE_DB = 1.0
UNSETTLED = ", not settled"  # beside a reduction that is not yet what it comes to


def design(result: StudyResult) -> Section:
    """Each controller on the design model."""
    rows: list[tuple[object, ...]] = []
    sentences: list[str] = []
    for name, outcome in result.designs.items():
        facts = outcome.facts
        figures = (_number(facts.gamma), _number(facts.achieved), _number(facts.peak_sensitivity_db, 1))
        rows.append((name, facts.method, facts.states, *figures, *_beside_limit(result, name)))
        sentences.append(f"{name}: {' '.join([facts.status, *_remarks(facts)])}")
    low, high = result.plan.band_hz
    quiet = (f"worst direction {low:.4g}-{high:.4g} Hz, dB", "no linear law beyond, dB")
    columns = ("controller", "method", "states", "gamma", "achieved", "peak of S, dB", *quiet)
    caption = (
        "Controllers as they run, on the design model; gamma and achieved are of the design before a reduction; no "
        "linear law reaches beyond at the same peak of S and the same gain of the control"
    )
    if laws.is_tall(result):
        caption += "; the worst direction is that of those which the plant moves most, as many as it has inputs"
    tables = [Table(caption, columns, rows), margins_table(result)]
    shaped = [*laws.shaped_charts(result), *laws.weight_charts(result)]
    figures = [*shaped, *laws.margin_charts(result), *laws.locus_charts(result)]
    return Section("Design", [_in_short(result)], tables, figures, sentences)


def _beside_limit(result: StudyResult, name: str) -> tuple[str, str]:
    """Return how quiet a law makes the band on the design model, and what no linear law goes beyond at its price."""
    limit = result.limits.facts.designs.get(name)
    if not isinstance(limit, DesignLimit):
        return "-", "-"
    return _number(limit.attenuation_db, 1), _number(limit.limit_db, 1)


def _in_short(result: StudyResult) -> str:
    """Say how many laws there are, and which of them the study is for."""
    found = len(result.laws)
    name = laws.chosen(result)
    text = f"{found} of {counted(len(result.designs), 'design')} found a law. " if found < len(result.designs) else ""
    only = len(result.designs) == 1
    stands = "The study has one law" if only else f"{counted(len(result.designs), 'law')} stand side by side"
    return f"{text}{stands}, drawn blue: {name}. {opening(result.designs[name].facts.status)}"


def reductions(result: StudyResult) -> list[Table]:
    """Return what each reduction left of what its law promised: a line before, a line after."""
    rows: list[tuple[object, ...]] = []
    for name, outcome in result.designs.items():
        reduction = outcome.facts.reduction
        if reduction is None or reduction.before is None or reduction.after is None:
            continue
        states = (reduction.from_states, outcome.facts.states)
        for when, n, d in zip(("before", "after"), states, (reduction.before, reduction.after), strict=True):
            band = "-" if d.worst_direction_band_db is None else _number(d.worst_direction_band_db, 1)
            tones = ", ".join(f"{_number(db, 1)} at {f} Hz" for f, db in d.tones_db.items())
            margins = ", ".join(f"{end} {_number(alpha, 3)}" for end, alpha in d.disk.items())
            rms = "-" if d.rms_db is None else _number(d.rms_db, 1)
            rows.append((name, when, n, _number(d.peak_db, 1), band, tones, rms, _number(d.control_db, 1), margins))
    columns = (
        "controller",
        "reduction",
        "states",
        "peak of S",
        "worst direction in band",
        "at tones",
        "RMS of S G below G",
        "K S",
        "disk margins",
    )
    return [Table("What each reduction left, on the design model, dB", columns, rows)] if rows else []


def margins_table(result: StudyResult) -> Table:
    """What every law stands at both ends of the design model, as it runs."""
    rows: list[tuple[object, ...]] = []
    for name, outcome in result.designs.items():
        for side, at in outcome.facts.law_margins.items():
            least = at.least_change
            said = "none upsets it"
            if least is not None:
                amount = f"{least.amount:+.3g} dB" if least.kind == "gain" else f"{least.amount:.3g} degrees"
                said = f"{amount} of {least.channel}, at {hertz(least.f_hz)}"
            together = "-" if at.disk_all is None else _number(at.disk_all, 2)
            worst = (min(at.gain_up_db.min(), at.gain_down_db.min()), at.phase_deg.min(), at.disk.min())
            rows.append((name, side, *(_number(float(w), 3) for w in worst), together, said))
    columns = (
        "controller",
        "end",
        "gain, dB",
        "phase, degrees",
        "disk, each",
        "disk, all at once",
        "least change alone",
    )
    return Table("Margins at the plant's ends, on the design model, of the law that runs", columns, rows)


def _remarks(facts: DesignFacts) -> list[str]:
    remarks: list[str] = []
    idle = facts.norm_without_control
    if idle is not None and facts.achieved < IDLE:
        remarks.append(f"The same cost without any control is {idle:.3g}: as printed, the weights ask for nothing.")
    if facts.recovery is not None:
        least = facts.recovery.least_relative_error
        remarks.append(f"Recovery at the {facts.recovery.at}: |L - L target| is at best {least:.2g} |L target|.")
    if facts.reduction is not None:
        remarks.append(f"From {counted(facts.reduction.from_states, 'state')}. {opening(facts.reduction.status)}")
    return remarks


def closed_loop(result: StudyResult) -> Section:
    """Each loop on the bench of every unit."""
    plan, counted = result.plan, _counts_plant(result)
    low, high = plan.band_hz
    heads = [h for t in plan.tones_hz for h in (f"{t:g} Hz", *([f"{t:g} Hz as the paper counts"] if counted else []))]
    columns = (
        "controller",
        "unit",
        *heads,
        f"{low:.4g}-{high:.4g} Hz rms",
        f"worst direction {low:.4g}-{high:.4g} Hz",
        "peak",
    )
    table = Table("On the bench, dB, positive is quieter; peak is amplification", columns, _loop_rows(result))
    chart = laws.measured_chart(result, tuple(result.loops))
    figures: list[Picture] = [] if chart is None else [chart]
    tables = [table, *_requirements(result.requirements)]
    details = [*_about_tones(result), *_verdicts(result), *_unsettled(result), *_noise_limits(result)]
    return Section("Closed loop", [*_on_the_bench(result)], tables, [*figures, *_time_responses(result)], details)


def _on_the_bench(result: StudyResult) -> list[str]:
    """Say of every loop that did not settle that it did not, and of the others how quiet the best of them is."""
    stable = [
        (loop.worst_direction_band_db, name, unit)
        for name, unit, loop in _loops(result)
        if isinstance(loop, StableLoop)
    ]
    failed = [loop.on(name, unit) for name, unit, loop in _loops(result) if isinstance(loop, UnstableLoop)]
    text = [f"{'; '.join(failed)}."] if failed else []
    if stable:
        db, name, unit = max(stable)
        low, high = result.plan.band_hz
        reached = f"over {low:.4g}-{high:.4g} Hz with {name} on {of_the_bench(unit)}"
        most = f"is {'quietest' if db > 0 else 'least loud'} {reached}: {loudness(db)}"
        text.append(
            f"{'The law' if len(result.loops) == 1 else 'Every law'} was run on the bench as it stands in its code. "
            "The worst direction, the largest singular value of the sensitivity that was measured, "
            f"{most if len(stable) > 1 else f'is {loudness(db)} {reached}'}."
        )
    return text


def _about_tones(result: StudyResult) -> list[str]:
    """Say what the columns of tones mean, and what a paper reported of its own."""
    if not result.plan.tones_hz:
        return []
    text = "A column headed by a tone is -20 log10(|y closed| / |y open|) of the worst channel."
    paper = result.study.paper
    if paper is None:
        return [text]
    said = [f"The paper's simulations: {sentence}." for sentence in paper.says]
    if not paper.counts_plant:
        return [text, *said]
    counted = (
        " As the paper counts, -20 log10(|y closed| / |d|) holds the plant's own gain as well: the row 'no control' "
        "shows how much of it is had for nothing."
    )
    return [text + counted, *said]


def _counts_plant(result: StudyResult) -> bool:
    """Return whether the study is that of a paper that counts the plant's own gain as attenuation."""
    return result.study.paper is not None and result.study.paper.counts_plant


def _requirements(facts: RequirementsFacts | None) -> list[Table]:
    """Return what the study asked of its law and what came of it."""
    if facts is None:
        return []
    low, high = facts.band_hz
    rows: list[tuple[object, ...]] = []
    for each in facts.judged:
        words, unit = in_short(each.requirement, facts.band_hz)
        found = "-" if each.figure is None else f"{_number(each.figure, 3)}{unit}"
        rows.append((words, each.where, f"{each.asked:g}{unit}", found, Verdict.of(each.met)))
    caption = f"Required of {facts.law}, worst direction over {low:.4g}-{high:.4g} Hz, disk margins on the design model"
    return [Table(caption, ("requirement", "where", "asked", "found", "verdict"), rows, folded=True)]


def _verdicts(result: StudyResult) -> Iterator[str]:
    """Say of every loop whether it is stable, by what growth, and what of its sensitivity noise hides."""
    for name, unit, loop in _loops(result):
        growth = (
            ""
            if loop.growth_per_s is None
            else f"; slowest mode {loop.growth_per_s:+.3g} a second at {loop.growth_hz:.4g} Hz"
        )
        word = "stable" if isinstance(loop, StableLoop) else loop.word
        hidden = f" {loop.lines_hidden}" if isinstance(loop, StableLoop) and loop.lines_hidden else ""
        yield f"{name}, {unit}: {word}{growth}.{hidden}"


def _loops(result: StudyResult) -> Iterator[tuple[str, str, StableLoop | UnstableLoop]]:
    """Yield controller, unit and how the loop did."""
    for name, outcome in result.loops.items():
        for unit, loop in outcome.facts.units.items():
            yield name, unit, loop


def _loop_rows(result: StudyResult) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    columns = 1 + _counts_plant(result)
    for name, unit, loop in _loops(result):
        if isinstance(loop, UnstableLoop):
            rows.append((name, unit, loop.word, *[""] * (2 + columns * len(result.plan.tones_hz))))
            continue
        tones = [
            f"{_number(db, 1)}{'' if tone.settled else UNSETTLED}"
            for tone in loop.tones.values()
            for db in (tone.reduction_db, tone.paper_db)[:columns]
        ]
        rest = (loop.broadband_db, loop.worst_direction_band_db, loop.peak_amplification_db)
        rows.append((name, unit, *tones, *("-" if db is None else _number(db, 1) for db in rest)))
    return [*(_idle_rows(result) if _counts_plant(result) else []), *rows]


def _idle_rows(result: StudyResult) -> list[tuple[object, ...]]:
    """Return one row a unit of what the paper's number is without any control."""
    rows: dict[str, tuple[object, ...]] = {}
    for _, unit, loop in _loops(result):
        if isinstance(loop, StableLoop) and unit not in rows:
            d = result.plan.amplitude
            own = [20 * np.log10(d / tone.open_v.max()) for tone in loop.tones.values()]
            rows[unit] = ("no control", unit, *(c for v in own for c in ("0", _number(v, 1))), "0", "0", "0")
    return list(rows.values())


def _unsettled(result: StudyResult) -> Iterator[str]:
    """Say which tones had not settled when the longest run ended: what is said of them is not yet what they come to."""
    for name, unit, loop in _loops(result):
        tones = [f for f, tone in loop.tones.items() if not tone.settled] if isinstance(loop, StableLoop) else []
        if tones:
            where = " and ".join(f"{f} Hz" for f in tones)
            yield f"{name}, {unit}: at {where} the amplitude was still changing when the longest run ended."


def _noise_limits(result: StudyResult) -> list[str]:
    """Say at which tones noise hides more than a controller may have reached."""
    for _, _, loop in _loops(result):
        if isinstance(loop, StableLoop) and loop.tones:
            limits = [
                f"{20 * np.log10(tone.open_v.min() / tone.floor_v.max()):.0f} dB at {f} Hz"
                for f, tone in loop.tones.items()
                if tone.settled
            ]
            if not limits:
                continue
            return [f"Noise feigns a rest of the tone: reductions cannot be told beyond about {', '.join(limits)}."]
    return []


def _time_responses(result: StudyResult) -> list[Picture]:
    """Return what the chosen law does to the tone that it attenuates most, if it attenuates any."""
    name, first = laws.chosen(result), result.plan.units[0]
    loop = result.loops[name].facts.units[first] if name in result.loops else None
    if not isinstance(loop, StableLoop) or not loop.tones:
        return []
    tone, best = max(loop.tones.items(), key=lambda item: item[1].reduction_db)
    records = result.under_tone(name, float(tone))
    if best.reduction_db <= DRAWN_ABOVE_DB or records is None:
        return []
    units = " ".join(dict.fromkeys(c.unit for c in records[0].actuators if c.unit))
    sent = f"{result.plan.amplitude:g} {units}".strip()
    note = noted(result, "under_tone")
    closed, opened = records
    seen = waterfall(name, float(tone), {"open loop": opened, "closed loop": closed}, span(result))
    return [
        bench.densities(name, float(tone), *records),
        seen,
        bench.under_tone(name, float(tone), sent, *records, note),
    ]


def _number(value: float, digits: int = 4) -> str:
    if not np.isfinite(value):
        return "-"
    return rounded(value) if digits == 1 else f"{value:.{digits}g}"
