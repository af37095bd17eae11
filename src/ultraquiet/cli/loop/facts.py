"""What a loop keeps, as tables with the channels' names and units, and as JSON."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet._base.shown.line import rounded
from ultraquiet.analyse.disk import ENDS
from ultraquiet.cli.output.text_table import TextTable

if TYPE_CHECKING:
    from ultraquiet.analyse import EndMargins
    from ultraquiet.design.loop_analysis import LoopAnalysis, SlowestMode
    from ultraquiet.values import StateSpace

HEADS = ("end", "channel", "unit", "gain up", "gain down", "phase", "delay", "disk")
TONE_FACTS = ("depth_db", "settling_s", "phase_margin_deg", "directions", "slowed")
DIGIT_HZ = 6  # of a frequency, below which it is 0 Hz for a reader


def wires(plant: "StateSpace", end: str) -> tuple[Any, ...]:
    """Return the channels at an end of a plant."""
    return plant.actuators if end == "input" else plant.sensors


def margins_grid(plant: "StateSpace", margins: "Mapping[str, EndMargins]") -> TextTable:
    """Return what each channel of each end stands by itself, the others as they are."""
    grid = TextTable(HEADS, "margins of each channel, the others as they are")
    for end in ENDS:
        at = margins[end]
        for k, wire in enumerate(wires(plant, end)):
            gains = (decibels(at.gain_up_db[k]), decibels(-at.gain_down_db[k]))
            rest = (degrees(at.phase_deg[k]), seconds(at.delay_s[k]), f"{at.disk[k]:.3g}")
            grid.add(end, wire.name, wire.unit, *gains, *rest)
    return grid


def margins_facts(plant: "StateSpace", margins: "Mapping[str, EndMargins]") -> dict[str, Any]:
    """Return the margins of both ends by channel name."""
    return {end: _end_facts(plant, end, margins[end]) for end in ENDS if end in margins}


def _end_facts(plant: "StateSpace", end: str, at: "EndMargins") -> dict[str, Any]:
    names = ("gain_up_db", "gain_down_db", "phase_deg", "delay_s", "disk")
    change = at.least_change
    least = None
    if change is not None:
        least = {
            "channel": wires(plant, end)[change.channel].name,
            "kind": change.kind,
            "amount": change.amount,
            "f_hz": change.f_hz,
        }
    return {
        "disk_all": at.disk_all,
        "disk_all_hz": at.disk_all_hz,
        "least_change": least,
        "channels": [
            {"name": wire.name, "unit": wire.unit, **{name: float(getattr(at, name)[k]) for name in names}}
            for k, wire in enumerate(wires(plant, end))
        ],
    }


def peaks_grid(found: "LoopAnalysis") -> TextTable:
    """Return the largest gain of S, T and KS, where it is, and between which channels."""
    grid = TextTable(
        ("response", "peak", "unit", "at", "most from", "most to"), "peaks of the loop at the plant's outputs"
    )
    for name, peak in found.peaks.items():
        unit = peak.unit or ("of the plant's own scales" if name == "KS" else "")
        grid.add(name, decibels(peak.gain_db), unit, hertz(peak.f_hz), peak.into or "-", peak.out_of or "-")
    return grid


def band_sentence(attenuation_db: float, at_hz: float, band_hz: tuple[float, float]) -> str:
    """Return one sentence on the worst direction over a band."""
    band = f"{band_hz[0]:.4g} to {band_hz[1]:.4g} Hz"
    if not np.isfinite(attenuation_db):
        return f"attenuation of the worst direction over {band}: none, the loop is unstable"
    what = "attenuation" if attenuation_db >= 0 else "amplification"
    return f"{what} of the worst direction over {band}: {decibels(abs(attenuation_db))}, at {hertz(at_hz)}"


def slowest_sentence(slowest: "SlowestMode | None") -> str:
    """Return one sentence on the slowest pole of a loop, or pair of them."""
    if slowest is None:
        return "the loop has no states"
    does = "grows" if slowest.growth_per_s > 0 else "decays"
    does = f"{does} by {abs(slowest.growth_per_s):.4g} e-folds a second"
    if slowest.f_hz == 0:
        return f"slowest pole: real, {does}"
    return f"slowest pair: {hertz(slowest.f_hz)}, {does}, damping {slowest.damping:.3g}"


def decibels(value: float) -> str:
    """Return decibels for a reader."""
    return f"{rounded(value, 2)} dB" if np.isfinite(value) else "any"


def degrees(value: float) -> str:
    """Return a phase for a reader."""
    return f"{value:.4g} deg" if np.isfinite(value) else "any"


def hertz(value: float) -> str:
    """Return a frequency for a reader."""
    return f"{round(value, DIGIT_HZ):.4g} Hz" if np.isfinite(value) else "-"


def seconds(value: float) -> str:
    """Return a time for a reader, in milliseconds where it is short."""
    if not np.isfinite(value):
        return "any"
    return f"{value:.4g} s" if value >= 1 else f"{1e3 * value:.4g} ms"


def tones_facts(details: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return what a law against tones does at each of them; nothing of a design that says nothing of tones."""
    names = [name for name in TONE_FACTS if name in details]
    tones = details["settling_s"] if "settling_s" in names else {}
    return [{"f_hz": tone, **{name: details[name][tone] for name in names}} for tone in tones]


def tones_grid(tones: list[dict[str, Any]]) -> TextTable:
    """Return the same as a table."""
    grid = TextTable(("tone", "depth", "settles", "phase"), "the tones, on the design model")
    for each in tones:
        at = (decibels(each["depth_db"]), seconds(each["settling_s"]), degrees(each["phase_margin_deg"]))
        grid.add(f"{each['f_hz']:g} Hz", *at)
    return grid
