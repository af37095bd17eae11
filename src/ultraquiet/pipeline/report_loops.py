"""What the report says of controllers, loops and code."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.plot import Figure, paper
from ultraquiet.report import Section, Table

PAPER_SAYS = "33 dB at 5 Hz, 12 dB (abstract) or 13 dB (text) at 25 Hz, nothing satisfactory at 100 Hz (section 4.2)"
# A cost this small beside what the paper's T <= 1 row alone would weigh says that the optimum is to do nothing.
IDLE = 1e-3
# A response is drawn for each controller at the tone it attenuates most, if it attenuates at all.
DRAWN_ABOVE_DB = 1.0


def design(done: StudyResult) -> Section:
    """Each controller on the design model."""
    rows, words = [], []
    for name, outcome in done.designs.items():
        facts = outcome.facts
        numbers = [facts.get(key) for key in ("gamma", "achieved", "peak_sensitivity_db")]
        rows.append((name, facts["method"], facts["states"], *(_number(v) for v in numbers)))
        words.append(f"{name}: {' '.join([facts['status'], *_remarks(facts)])}")
    columns = ("controller", "method", "states", "gamma", "achieved", "peak of S, dB")
    return Section("Design", words, [Table("Controllers, on the design model, before reduction", columns, rows)])


def _remarks(facts: Mapping[str, Any]) -> list[str]:
    details, remarks = facts.get("details", {}), []
    if "norm_without_control" in details and facts["achieved"] < IDLE:
        idle = details["norm_without_control"]
        remarks.append(f"The same cost without any control is {idle:.3g}: as printed, the weights ask for nothing.")
    if "recovery" in details:
        lowest = min(details["recovery"]["relative_error"])
        remarks.append(
            f"Recovery at the {details['recovery']['at']}: |L - L target| is at best {lowest:.2g} |L target|."
        )
    if "reduction" in facts:
        r = facts["reduction"]
        remarks.append(f"From {r['from_states']} states. {r['status']}")
    return remarks


def closed_loop(done: StudyResult) -> Section:
    """Each loop on the bench of every unit."""
    settings = done.study.closed_loop
    low, high = settings.band_hz
    heads = [h for t in settings.tones_hz for h in (f"{t:g} Hz", f"{t:g} Hz paper_db")]
    columns = ("controller", "unit", *heads, "5-100 Hz rms", f"worst direction {low:g}-{high:g} Hz", "peak")
    table = Table("On the bench, dB, positive is quieter; peak is amplification", columns, _loop_rows(done))
    text = [
        "A column headed by a tone is reduction_db = -20 log10(|y closed| / |y open|) of the worst channel. paper_db = "
        "-20 log10(|y closed| / |d|) counts the plant's own gain as well: the row 'no control' shows how much of it is "
        "had for nothing.",
        f"The paper's simulations: {PAPER_SAYS}.",
        "The worst direction is the largest singular value of the sensitivity matrix measured on the bench.",
        *_noise_limits(done),
    ]
    curves = _curves(done)
    figures = [paper.sensitivity(curves, settings.band_hz)] if curves else []
    return Section("Closed loop", text, [table], [*figures, *_time_responses(done)])


def _loop_rows(done: StudyResult) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name, outcome in done.loops.items():
        for unit, facts in outcome.facts.items():
            if not facts["stable"]:
                rows.append((name, unit, facts["status"], *[""] * (2 + 2 * len(done.study.closed_loop.tones_hz))))
                continue
            tones = [_number(t[k], 1) for t in facts["tones"].values() for k in ("reduction_db", "paper_db")]
            rest = (facts["broadband_5_100_db"], facts["worst_direction_band_db"], facts["peak_amplification_db"])
            rows.append((name, unit, *tones, *(_number(v, 1) for v in rest)))
    return [*_idle_rows(done), *rows]


def _idle_rows(done: StudyResult) -> list[tuple[object, ...]]:
    """Return one row a unit of what the paper's number is without any control."""
    rows: dict[str, tuple[object, ...]] = {}
    for outcome in done.loops.values():
        for unit, facts in outcome.facts.items():
            if facts["stable"] and unit not in rows:
                d = done.study.closed_loop.amplitude_v
                own = [20 * np.log10(d / max(t["open_v"])) for t in facts["tones"].values()]
                rows[unit] = ("no control", unit, *(c for v in own for c in ("0", _number(v, 1))), "0", "0", "0")
    return list(rows.values())


def _noise_limits(done: StudyResult) -> list[str]:
    """Say at which tones noise hides more than a controller may have reached."""
    for outcome in done.loops.values():
        for facts in outcome.facts.values():
            if facts["stable"]:
                limits = [
                    f"{20 * np.log10(min(t['open_v']) / max(t['floor_v'])):.0f} dB at {f} Hz"
                    for f, t in facts["tones"].items()
                ]
                return [f"Noise feigns a rest of the tone: reductions cannot be told beyond about {', '.join(limits)}."]
    return []


def _curves(done: StudyResult) -> dict[str, tuple[FloatArray, FloatArray]]:
    curves: dict[str, tuple[FloatArray, FloatArray]] = {}
    unit = done.study.closed_loop.units[0]
    for name, outcome in done.loops.items():
        S = outcome.values.get(f"{name}-{unit}-sensitivity")
        if S is not None:
            size = np.linalg.svd(np.moveaxis(S.values, 2, 0), compute_uv=False)[:, 0]
            curves[name] = (S.f_hz, -20 * np.log10(size))
    return curves


def _time_responses(done: StudyResult) -> list[Figure]:
    figures: list[Figure] = []
    unit = done.study.closed_loop.units[0]
    for name, outcome in done.loops.items():
        tones = outcome.facts.get(unit, {}).get("tones", {})
        if not tones:
            continue
        tone, best = max(tones.items(), key=lambda item: item[1]["reduction_db"])
        runs = [outcome.values.get(f"{kind}-{tone}hz") for kind in (name, "open")]
        if best["reduction_db"] > DRAWN_ABOVE_DB and runs[0] is not None and runs[1] is not None:
            figures.append(paper.closed_loop(name, float(tone), runs[0], runs[1]))
    return figures


def code(done: StudyResult) -> Section:
    """The generated code of each controller."""
    keys = ("states", "form", "c31_cycles", "c31_budget", "flash_bytes", "ram_bytes", "bit_exact")
    rows = [(name, *(str(t.get(k, "-")) for k in keys)) for name, t in done.deployment.items()]
    words = [f"{name}: {t.get('verification', t['status'])}" for name, t in done.deployment.items()]
    note = "C31 cycles come from a model of the processor: a law fits the model, it has not run on the processor."
    return Section("Code", [*words, note], [Table("Generated C99", ("controller", *keys), rows)])


def _number(value: Any, digits: int = 4) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.{digits}f}" if digits == 1 else f"{value:.{digits}g}"
