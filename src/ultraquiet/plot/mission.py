"""What laws are for, as figures: the payload before (grey) and after (blue)."""

from ultraquiet._base.constraints import FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel

HZ = "frequency (Hz)"
BEFORE, AFTER = 7, 0  # shades: grey, blue
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
