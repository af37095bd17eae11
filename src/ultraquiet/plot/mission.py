"""What laws are for, as figures: the payload before (grey) and after (blue)."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel

HZ = "frequency (Hz)"
BEFORE, AFTER = 7, 0  # shades: grey, blue
BINS = 30
Pair = tuple[FloatArray, FloatArray]


def payload(
    name: str, units: dict[str, tuple[FloatArray, Pair, Pair]], ratio: str, unit: str, band_hz: tuple[float, float]
) -> Figure:
    """Transmissibility and cumulative RMS of each unit's payload.

    Args:
        name: of the law.
        units: name of a unit -> frequencies `(nf,)`, payload over base and cumulative RMS, each without and with it.
        ratio: label of the axis of transmissibility.
        unit: of the RMS.
        band_hz: shaded.
    """
    panels: list[Panel] = []
    for title, (f, over_base, rms) in units.items():
        moved = [Line.of(f, over_base[0], "without", shade=BEFORE), Line.of(f, over_base[1], name, shade=AFTER)]
        summed = [Line.of(f, rms[0], "without", shade=BEFORE), Line.of(f, rms[1], name, shade=AFTER)]
        panels.append(Panel(moved, f"{title}: {ratio}", HZ, "", True, y_log=True, spans=[band_hz]))
        panels.append(Panel(summed, f"{title}: RMS up to a frequency", HZ, unit, True, spans=[band_hz]))
    caption = "The payload while the base is shaken, without the law (grey) and with it (blue)."
    return Figure("payload", f"What the payload feels, {name}", caption, panels, 2, (8.0, 2.8 * len(units)))


def campaign(
    figures: dict[str, dict[str, FloatArray]],
    drivers: dict[str, dict[str, float]],
    f_hz: FloatArray,
    cases: dict[str, FloatArray],
) -> Figure:
    """How figures spread over drawn benches, what drives them, and the loop of single cases.

    Args:
        figures: label of a figure -> unit -> values of its cases.
        drivers: label of a figure -> parameter -> rank correlation.
        f_hz: of the curves.
        cases: name of a case -> worst direction of its S in dB `(nf,)`.
    """
    panels: list[Panel] = []
    for title, units in figures.items():
        shown = [values[np.isfinite(values)] for values in units.values()]
        edges = np.histogram_bin_edges(np.concatenate([*shown, np.zeros(0)]), BINS)
        named = enumerate(zip(units, shown, strict=True))
        lines = [_histogram(values, edges, unit, k) for k, (unit, values) in named if values.size]
        panels.append(Panel(lines, title, "dB", "benches"))
    for title, found in drivers.items():
        ranked = enumerate(found.items())
        bars = [Line.of([0.0, rho], [-k, -k], f"{name} {rho:+.2f}", shade=k) for k, (name, rho) in ranked]
        panels.append(Panel(bars, f"what drives it: {title}", "rank correlation", "", x_range=(-1.0, 1.0)))
    if cases:
        two = zip(cases.items(), (BEFORE, AFTER), strict=False)
        lines = [Line.of(f_hz, db, name, shade=shade) for (name, db), shade in two]
        panels.append(Panel(lines, "worst direction of S", HZ, "dB", True))
    caption = "One law on drawn benches: the median case (grey) and the worst stable one (blue) below."
    return Figure("campaign", "Drawn benches", caption, panels, 2, (8.0, 2.6 * -(-len(panels) // 2)))


def _histogram(values: FloatArray, edges: FloatArray, label: str, shade: int) -> Line:
    counts, edges = np.histogram(values, edges)
    x = np.repeat(edges, 2)
    return Line.of(x, np.concatenate([[0.0], np.repeat(counts, 2), [0.0]]), label, shade=shade)
