"""The picture one remembers: the payload while the base shakes, before and after."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Region, decibel_axis, frequency_axis
from ultraquiet.plot.pages.bench import UP_TO_HERE


@dataclass(frozen=True, eq=False)
class Before:
    """One unit's payload without the law and with it, `(nf,)` each: over the base, and the rms up to a frequency."""

    f_hz: FloatArray
    over_base: tuple[FloatArray, FloatArray]
    cumulative: tuple[FloatArray, FloatArray]


def payload_chart(
    stem: str,
    name: str,
    units: Mapping[str, Before],
    words: tuple[str, str, str],
    band_hz: tuple[float, float],
    told: str,
) -> Chart:
    """Transmissibility over cumulative rms, every unit's before (grey) and after (blue).

    Args:
        stem: of the figure's name.
        name: of the law.
        units: what each unit's payload felt.
        words: what is over what, and its unit; the unit of the rms.
        band_hz: over which it counts.
        told: what came of it, in a sentence.
    """
    dashes: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
    over, total = list[Curve](), list[Curve]()
    for k, (unit, felt) in enumerate(units.items()):
        place = f", {unit}" if len(units) > 1 else ""
        for which, word, colour in ((0, "without", "open"), (1, name, "chosen")):
            dash = dashes[k % 4]
            db = 20 * np.log10(np.maximum(felt.over_base[which], 1e-300))
            over.append(Curve(f"{word}{place}", felt.f_hz, db, colour, dash))
            total.append(Curve(f"{word}{place}", felt.f_hz, felt.cumulative[which], colour, dash))
    ratio, per, rms = words
    f = next(iter(units.values())).f_hz
    narrower = band_hz[0] > 1.2 * f[0] or band_hz[1] < f[-1] / 1.2  # a band that is all there is needs no shade
    band = [Region(f"{band_hz[0]:.4g}-{band_hz[1]:.4g} Hz", band_hz)] if narrower else []
    panels = [
        ChartPanel(frequency_axis(), decibel_axis(ratio, per), over, regions=band, height=250),
        ChartPanel(frequency_axis(), Axis(f"rms ({rms})"), total, UP_TO_HERE, band, height=150),
    ]
    return Chart(stem, "What the payload feels while the base shakes", told, panels)
