"""The real-time frame as a figure: its time line, the end of every step, counter and ramp."""

from typing import TYPE_CHECKING

import numpy as np

from ultraquiet.plot.figure import Figure, Line, Panel

if TYPE_CHECKING:
    from ultraquiet.deploy import FrameSimulation


def frame_figure(simulation: "FrameSimulation") -> Figure:
    """Return a figure of simulated frames: the worst frame's parts, when each step ended, overruns and ramp."""
    spans = simulation.spans_us(simulation.worst_frame)
    bars = [Line.of([a, b], [-k, -k], name, shade=k) for k, (name, a, b) in enumerate(spans)]
    period = 1e6 * simulation.period_s
    seconds = np.arange(simulation.frames) * simulation.period_s
    ran = ~simulation.skipped
    ends = [
        Line.of(seconds[ran], 1e6 * simulation.finish_s[ran], "step ends"),
        Line.of(seconds[ran], 1e6 * simulation.written_s[ran], "converters written", shade=2),
        Line.of(seconds[[0, -1]], [period, period], "next interrupt", "--", 1),
    ]
    level = simulation.level / max(1, int(simulation.level.max()))
    count = simulation.overruns / max(1, simulation.overrun_count)
    counters = [
        Line.of(seconds, level, "ramp's level, of its largest"),
        Line.of(seconds, count, f"overruns, of {simulation.overrun_count}", "--", 1),
    ]
    panels = (
        Panel(
            bars,
            f"frame {simulation.worst_frame}, the worst",
            "us after the interrupt was due",
            y_range=(-len(bars), 1),
        ),
        Panel(ends, "every frame", "s", "us"),
        Panel(counters, "what the code counted", "s"),
    )
    return Figure("frame", "The real-time frame", str(simulation.status), panels, columns=1, size_in=(8.0, 7.0))
