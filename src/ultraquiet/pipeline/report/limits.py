"""What the report says of limits."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.shown.line import opening, rounded
from ultraquiet.pipeline.facts.limits import BandLimit, DesignLimit, NoDistance, RefusedBand
from ultraquiet.pipeline.report.laws import unit_of_control
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Section, Table

# A difference between two bands that is worth a sentence.
MARKED_DB = 3.0
COLUMNS = (
    "controller",
    "worst direction, dB",
    "peak of S, dB",
    "|K S|",
    "reached there alone, dB",
    "none beyond, dB",
    "left, dB",
)
OF_EVERY = ("reached there alone, dB, {}", "none beyond, dB, {}")  # plant within the uncertainty


def limits(result: StudyResult) -> Section:
    """What no linear controller can reach on the identified plant, and what each design leaves of it."""
    facts = result.limits.facts
    told = [limit for limit in (*facts.bands, *facts.designs.values()) if isinstance(limit, BandLimit | DesignLimit)]
    off = max((limit.uncertainty for limit in told), default=0.0)
    every = f"every plant off by up to {100 * off:.3g} %"
    fewer = f" Where the peak and the attenuation are to be those of {every}, less can be had." if off else ""
    rows = [(name, *_figures(limit, bool(off))) for name, limit in facts.designs.items()]
    of_control = unit_of_control(result)
    unit = f" {of_control}" if of_control else ""
    text = [
        "On the identified plant, along the direction that it moves least: what cannot be reached there cannot be "
        "reached in the worst direction. A bound holds for every linear controller at that peak and that gain, of any "
        f"order, without margin for errors of the model; a design that is to work in practice stays below it.{fewer}",
        *(_of_band(limit, unit) for limit in facts.bands),
        *_lower_end(facts.bands),
    ]
    low, high = result.plan.band_hz
    heads = tuple(f"|K S|,{unit}" if unit and head == "|K S|" else head for head in COLUMNS)
    heads += tuple(head.format(every) for head in OF_EVERY) if off else ()
    return Section(
        "Limits", text, [Table(f"Each design beside its own limit over {low:.4g}-{high:.4g} Hz", heads, rows)]
    )


def _figures(limit: DesignLimit | NoDistance, of_every: bool) -> list[str]:
    if isinstance(limit, NoDistance):
        return ["-"] * (len(COLUMNS) - 1 + of_every * len(OF_EVERY))
    reached, beyond = (limit.attenuation_db, limit.peak_db), (limit.alone_db, limit.limit_db, limit.left_db)
    # An unstable loop has no |K S|.
    gain = f"{limit.control_gain:.3g}" if np.isfinite(limit.control_gain) else "-"
    robust = (limit.robust_alone_db, limit.robust_limit_db) if of_every else ()
    return [*map(_number, reached), gain, *map(_number, beyond), *map(_number, robust)]


def _of_band(limit: BandLimit | RefusedBand, unit: str) -> str:
    low, high = limit.band_hz
    if isinstance(limit, RefusedBand) or not np.isfinite(limit.bound_db):
        band = f"{low:.4g}-{high:.4g} Hz"
        return opening(limit.status) if band in limit.status else f"{band}: {limit.status}"
    return (
        f"{low:.4g}-{high:.4g} Hz at a peak of {limit.peak_db:g} dB and |K S| up to {limit.control_gain:.4g}{unit}: "
        f"{limit.attenuation_db:.1f} dB can be reached, {limit.bound_db:.1f} dB cannot be exceeded."
        f"{_of_every_plant(limit)}"
    )


def _of_every_plant(limit: BandLimit) -> str:
    """Say what can be had where every plant off by the uncertainty is to keep the same."""
    reached, bound = limit.robust_attenuation_db, limit.robust_bound_db
    on_every = f" On every plant off by up to {100 * limit.uncertainty:.3g} %: "
    if reached is None or bound is None or not np.isfinite(reached):
        return f"{on_every}{limit.robust_status}" if limit.robust_status else ""
    none = f"{bound:.1f} dB cannot be exceeded" if np.isfinite(bound) else "no bound was certified"
    return f"{on_every}{reached:.1f} dB can be reached, {none}."


def _lower_end(bands: Sequence[BandLimit | RefusedBand]) -> list[str]:
    """Say what the lower end of the broadest band costs, and whether the gain at low frequency is the reason."""
    broad, narrow = bands[0], bands[-1]
    if isinstance(broad, RefusedBand) or isinstance(narrow, RefusedBand):
        return []
    if not np.isfinite([broad.bound_db, narrow.bound_db]).all():
        return []
    lost = narrow.attenuation_db - broad.bound_db
    if narrow.band_hz[1] != broad.band_hz[1] or lost < MARKED_DB:
        return []
    low = broad.band_hz[0]
    spent = any(span[0] < low for span in broad.binding.get("control gain", ()))
    reason = " There the sensor hears little and the gain of the control is used up." if spent else ""
    return [
        f"Starting at {low:.4g} Hz instead of {narrow.band_hz[0]:g} Hz costs at least {lost:.0f} dB: the broad band "
        f"is limited at its lower end, {broad.band_hz[1]:g} Hz is not out of reach.{reason}"
    ]


def _number(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100 else rounded(value)
