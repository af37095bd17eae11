"""Benches as figures: the linear truth where they offer one, the limits of their channels everywhere."""

from typing import Any

import numpy as np

from ultraquiet._base.shown import draws
from ultraquiet.bench import Blended, Decimated, Fmu, Hardware, Hexapod, LinearBench, Process, Replay, Wrapped
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.plot.objects.models import model_figure, record_figure

FAR = 10.0  # what stands for no limit, times the largest that there is


@draws(LinearBench)
def linear_figure(bench: LinearBench) -> Figure:
    """The model that the bench is."""
    return model_figure(bench.model)


@draws(Hexapod)
def hexapod_figure(bench: Hexapod) -> Figure:
    """The linear truth of the unit, at its reference temperature."""
    return model_figure(bench.linear_model())


@draws(Replay)
def replay_figure(bench: Replay) -> Figure:
    """The first record that it plays."""
    return record_figure(bench.records[0])


@draws(Wrapped, Process, Hardware, Fmu, Blended, Decimated)
def channels_figure(bench: Any) -> Figure:
    """The range of each channel; nothing moves for a picture."""
    panels: list[Panel] = []
    for title, wires in (("actuators", bench.actuators), ("sensors", bench.sensors)):
        for unit in dict.fromkeys(c.unit for c in wires):
            of_unit = [c for c in wires if c.unit == unit]
            ends = [abs(end) for c in of_unit for end in (c.low, c.high) if np.isfinite(end)]
            far = FAR * max(ends, default=0.1)
            lines = [
                Line.of([max(c.low, -far), min(c.high, far)], [k, k], c.name, shade=k) for k, c in enumerate(of_unit)
            ]
            panels.append(Panel(lines, f"{title}, {unit or 'without unit'}", unit or "1", y_range=(-1, len(of_unit))))
    caption = f"Ranges of the channels at {bench.rate_hz:g} Hz."
    return Figure("bench", type(bench).__name__, caption, panels, 1, (8.0, 1.8 * len(panels)))
