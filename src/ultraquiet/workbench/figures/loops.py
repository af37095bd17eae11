"""Loops: S, T and KS of laws side by side, and their margins at both ends, channel by channel."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart.spec import Chart, ChartPanel, Curve, Mark, Region
from ultraquiet.linalg.response import principal_gains
from ultraquiet.workbench.figures.scale import Scale

MEMBERS = {
    "S": "S: what the law leaves of a disturbance, in the directions that the inputs reach",
    "T": "T: what it makes of sensor noise at the outputs",
    "KS": "K S: what it asks of the actuators",
}


@dataclass(frozen=True, eq=False)
class Sizes:
    """The largest singular values of S, T and KS of one loop over `f_hz`."""

    f_hz: FloatArray
    sizes: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class SensitivityDemand:
    """What is asked of |S|: quieter than `-attenuation_db` over `band_hz`, nowhere above `peak_db`."""

    band_hz: tuple[float, float] | None = None
    attenuation_db: float | None = None
    peak_db: float | None = None


def loop_grid(
    title: str,
    caption: str,
    laws: Mapping[str, Sizes],
    colours: Mapping[str, str],
    scale: Scale,
    asked: SensitivityDemand = SensitivityDemand(),
    bound: Sizes | None = None,
    unit: str = "",
) -> Chart:
    """Return S above T and KS: the worst direction of each law, what is asked of S, and a weight's bound dashed."""
    panels = []
    for member, words in MEMBERS.items():
        curves = [Curve(n, scale.x(s.f_hz), scale.y(s.sizes[member]), colours[n]) for n, s in laws.items()]
        if bound is not None and member in bound.sizes:
            shown = scale.y(bound.sizes[member])
            curves.append(Curve("bound of the weight", scale.x(bound.f_hz), shown, "chosen", "--"))
        regions, marks = _asked(asked, scale) if member == "S" else ([], [])
        axis = scale.gains(member, unit if member == "KS" and unit != "1/1" else "")
        height = 250 if member == "S" else 200
        panels.append(ChartPanel(scale.frequencies(), axis, curves, words, regions, marks, height))
    return Chart("loops", title, caption, panels, columns=1, legend="below")


def sizes_of(f_hz: FloatArray, S: np.ndarray, T: np.ndarray, KS: np.ndarray) -> Sizes:
    """Return the largest singular values of responses `(rows, columns, nf)`."""
    return Sizes(f_hz, {name: principal_gains(g)[0] for name, g in (("S", S), ("T", T), ("KS", KS))})


def _asked(asked: SensitivityDemand, scale: Scale) -> tuple[list[Region], list[Mark]]:
    regions, marks = [], []
    if asked.band_hz is not None and asked.attenuation_db is not None:
        low, high = (float(scale.x(f)) for f in asked.band_hz)
        top = -asked.attenuation_db if scale.decibels else 10 ** (-asked.attenuation_db / 20)
        # what is required is below the band's upper edge: the shade stands where S must not be
        regions.append(Region("required: S below this", (low, high), (top, None), "bad"))
    if asked.peak_db is not None:
        marks.append(Mark("largest peak", y=asked.peak_db if scale.decibels else 10 ** (asked.peak_db / 20)))
    return regions, marks
