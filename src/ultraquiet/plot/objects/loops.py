"""Laws, loops and limits as figures."""

from typing import Any

import numpy as np

from ultraquiet._base.shown import draws
from ultraquiet._base.shown.grid import shown_frequencies
from ultraquiet.analyse import EndMargins, Gang, Roots
from ultraquiet.design import DesignResult
from ultraquiet.limits import Limit
from ultraquiet.linalg.response import principal_gains
from ultraquiet.plot.figure import Figure, Fill, Line, Panel
from ultraquiet.plot.objects.anything import any_figure
from ultraquiet.plot.objects.models import model_figure
from ultraquiet.plot.page import outlines
from ultraquiet.plot.spectra import HZ
from ultraquiet.reduce import ReductionResult
from ultraquiet.simulate import Attenuation, MeasuredSensitivity

TINY = np.finfo(float).tiny
DEVIATIONS = 1.96


@draws(DesignResult)
def design_figure(result: DesignResult) -> Figure:
    """The law's gain and phase; of a refusal its words."""
    if result.controller is None:
        return any_figure(result)
    drawn = model_figure(result.controller)
    return Figure("law", "The law u = K y", str(result.status), drawn.panels, drawn.columns, drawn.size_in)


@draws(ReductionResult)
def reduction_figure(result: ReductionResult) -> Figure:
    """Hankel singular values, kept ones and lost ones, beside the reduced law."""
    drawn = model_figure(result.controller)
    hankel = np.asarray(result.hankel, dtype=float)
    k = np.arange(1.0, hankel.size + 1)
    values = Line.of(k, np.maximum(hankel, hankel.max(initial=TINY) * 1e-16), "singular values")
    kept = Panel(
        [values], "Hankel singular values", "state", "value", y_log=True, spans=[(0.5, result.controller.states + 0.5)]
    )
    panels = [kept, *drawn.panels] if hankel.size else drawn.panels
    return Figure("reduction", "Reduced law", str(result.status), panels, 2, (8.0, 2.2 * -(-len(panels) // 2)))


@draws(EndMargins)
def end_margins_figure(margins: EndMargins) -> Figure:
    """What each channel by itself stands, as bars; a channel that nothing upsets has none and is named."""
    kinds = (
        ("gain up", margins.gain_up_db, "dB"),
        ("gain down", margins.gain_down_db, "dB"),
        ("phase", margins.phase_deg, "degrees"),
        ("delay", margins.delay_s, "s"),
        ("disk margin", margins.disk, "1"),
    )
    panels = [_bars(name, np.asarray(values, dtype=float), unit) for name, values, unit in kinds]
    caption = f"Margins of each channel by itself; of all at once the disk margin is {margins.disk_all:.3g}."
    return Figure("margins", "Margins at one end of the plant", caption, panels, 1, (6.0, 1.7 * len(panels)))


def _bars(name: str, values: np.ndarray, unit: str) -> Panel:
    limited = np.isfinite(values)
    without = ", ".join(str(k + 1) for k in np.flatnonzero(~limited))
    if not limited.any():
        return Panel([], name, words=["nothing of that kind upsets the loop at any channel"])
    bars = Line(*outlines(np.flatnonzero(limited).astype(float), values[limited], 0.6))
    title = f"{name}; nothing upsets channel {without}" if without else name
    ends, names = (-0.5, values.size - 0.5), [str(k + 1) for k in range(values.size)]
    return Panel([bars], title, "channel", f"{name} ({unit})", x_range=ends, x_names=names)


@draws(Gang)
def gang_figure(gang: Gang) -> Figure:
    """The largest singular value of each function of the loop."""
    f_hz = shown_frequencies(gang.So)
    panels = [
        Panel([Line.of(f_hz, _largest_db(getattr(gang, name).frequency_response(f_hz)))], name, HZ, "dB", x_log=True)
        for name in ("So", "To", "KSo", "GSi")
    ]
    return Figure("gang", "The loop's functions", "Largest singular values.", panels, 2, (8.0, 4.8))


@draws(MeasuredSensitivity)
def sensitivity_figure(measured: MeasuredSensitivity) -> Figure:
    """Worst direction of S at each line with its 95 % interval."""
    size = 10.0 ** (-measured.worst_direction_db() / 20.0)
    low, high = (np.maximum(size + side * DEVIATIONS * measured.deviation, TINY) for side in (-1, 1))
    worst = 20 * np.log10(size)
    floor = float(worst.min()) - 20.0
    fill = Fill(measured.f_hz, np.maximum(20 * np.log10(low), floor), 20 * np.log10(high), "95 % interval")
    panel = Panel([Line.of(measured.f_hz, worst, "worst direction")], "S", HZ, "dB", x_log=True, fills=[fill])
    return Figure("measured_sensitivity", "Measured sensitivity", measured.reach, [panel])


@draws(Attenuation)
def attenuation_figure(found: Attenuation) -> Figure:
    """Reduction of each tone at each sensor."""
    tones = np.asarray(found.tones_hz, dtype=float)
    wires = found.opened[0].sensors if found.opened else ()
    labels = [c.name for c in wires] or [f"output {k + 1}" for k in range(found.reduction_db.shape[1])]
    lines = [
        Line.of(tones, found.reduction_db[:, k], label, "-" if tones.size > 1 else ".", k)
        for k, label in enumerate(labels)
    ]
    panel = Panel(lines, "reduction by closing the loop", "tone (Hz)", "dB", x_log=tones.size > 1)
    return Figure("attenuation", "Attenuation", "Positive is quieter.", [panel])


@draws(Limit)
def limit_figure(limit: Limit) -> Figure:
    """|S| of the best linear controller that was found."""
    if not limit.f_hz.size:
        return any_figure(limit)
    f = limit.f_hz > 0
    best = Line.of(limit.f_hz[f], 20 * np.log10(np.maximum(limit.sensitivity[f], TINY)), "best found")
    ends = limit.f_hz[f][[0, -1]]
    bound = [Line.of(ends, [-limit.bound_db] * 2, "no linear law, in the band", "--")] * bool(
        np.isfinite(limit.bound_db)
    )
    panel = Panel([best, *bound], "|S|", HZ, "dB", x_log=True)
    return Figure("limit", "What any controller can reach", str(limit.status), [panel])


@draws(Roots)
def roots_figure(found: Roots) -> Figure:
    """Poles or zeros in the plane."""
    values = np.asarray(found.values, dtype=complex)
    panel = Panel([Line(np.real(values), np.imag(values), style="x")], "", "real part", "imaginary part")
    return Figure("roots", "Poles or zeros", "", [panel], 1, (5.0, 5.0))


def _largest_db(values: Any) -> Any:
    return 20.0 * np.log10(np.maximum(principal_gains(values)[0], TINY))
