"""What the report says of limits."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Section, Table

# A difference between two bands that is worth a sentence.
MARKED_DB = 3.0


def limits(done: StudyResult) -> Section:
    """What no linear controller can reach on the identified plant, and what each design leaves of it."""
    facts = done.bounds.facts
    columns = (
        "controller",
        "worst direction, dB",
        "peak of S, dB",
        "|K S|",
        "reached there alone, dB",
        "none beyond, dB",
        "left, dB",
    )
    keys = ("attenuation_db", "peak_db", "control_gain", "alone_db", "limit_db", "left_db")
    rows = [(name, *(_number(told.get(key)) for key in keys)) for name, told in facts["designs"].items()]
    text = [
        "On the identified plant, along the direction that it moves least: what cannot be reached there cannot be "
        "reached in the worst direction. A bound holds for every linear controller at that peak and that gain, of any "
        "order, without margin for errors of the model; a design that is to work in practice stays below it.",
        *(_of_band(told) for told in facts["bands"]),
        *_edge(facts["bands"]),
    ]
    low, high = done.study.closed_loop.band_hz
    return Section("Limits", text, [Table(f"Each design beside its own limit over {low:g}-{high:g} Hz", columns, rows)])


def _of_band(told: Mapping[str, Any]) -> str:
    low, high = told["band_hz"]
    if _missing(told.get("bound_db")):
        return f"{low:g}-{high:g} Hz: {told['status']}"
    return (
        f"{low:g}-{high:g} Hz at a peak of {told['peak_db']:g} dB and |K S| up to {told['control_gain']:g} V/V: "
        f"{told['attenuation_db']:.1f} dB can be reached, {told['bound_db']:.1f} dB cannot be exceeded."
    )


def _edge(bands: list[Mapping[str, Any]]) -> list[str]:
    """Say what the lower end of the broadest band costs, and whether the gain at low frequency is the reason."""
    broad, narrow = bands[0], bands[-1]
    if any(_missing(told.get("bound_db")) for told in (broad, narrow)):
        return []
    lost = narrow["attenuation_db"] - broad["bound_db"]
    if narrow["band_hz"][1] != broad["band_hz"][1] or lost < MARKED_DB:
        return []
    low = broad["band_hz"][0]
    spent = any(span[0] < low for span in broad["binding"].get("control gain", ()))
    reason = " There the sensor hears little and the gain of the control is used up." if spent else ""
    return [
        f"Starting at {low:g} Hz instead of {narrow['band_hz'][0]:g} Hz costs at least {lost:.0f} dB: the broad band "
        f"is limited at its lower end, {broad['band_hz'][1]:g} Hz is not out of reach.{reason}"
    ]


def _missing(value: Any) -> bool:
    return value is None or not np.isfinite(value)


def _number(value: Any) -> str:
    return "-" if _missing(value) else f"{value:.0f}" if abs(value) >= 100 else f"{value:.1f}"
