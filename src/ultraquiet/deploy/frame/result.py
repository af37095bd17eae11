"""What a simulation of frames has found: instants, counters, a verdict, and the time line in words."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray, frozen, whole
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.frame.settings import FrameSettings
from ultraquiet.deploy.frame.times import FrameTimes
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.law.twin import FAULT, ON
from ultraquiet.values.status import Status, StatusWord

WIDTH = 60  # characters of a period in the time line


@dataclass(frozen=True, eq=False)
class FrameSimulation(Shown):
    """Frames one by one. Instants are seconds after the timer's nominal tick of their frame; NaN in skipped frames.

    `start_s` the step begins, `written_s` the converters hold the new command, `finish_s` the busy flag falls,
    `done_s` background work has caught up. `skipped` marks frames whose interrupt met an unfinished step, `late` frames
    that end with background work undone. `mode`, `faults`, `level` and `overruns` are the code's own after each frame,
    `largest_v` is the largest command. `hooked` counts calls of the overrun hook (None for the twin), `refused` those
    calls of `NAME_frame` whose answer was not the one expected (zero, or the code is wrong). `ran` says what was run.
    """

    status: Status
    frame: FrameSettings
    times: FrameTimes
    period_s: float
    start_s: FloatArray
    written_s: FloatArray
    finish_s: FloatArray
    done_s: FloatArray
    largest_v: FloatArray
    skipped: NDArray[np.bool_]
    late: NDArray[np.bool_]
    mode: NDArray[np.uint8]
    faults: NDArray[np.uint8]
    level: NDArray[np.uint32]
    overruns: NDArray[np.uint32]
    hooked: int | None
    refused: int
    ran: str

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.skipped.size

    @property
    def overrun_count(self) -> int:
        """Overruns that the code has counted."""
        return int(self.overruns[-1])

    @property
    def late_count(self) -> int:
        """Frames that ended with background work undone."""
        return int(np.count_nonzero(self.late))

    @cached_property
    def busy_s(self) -> FloatArray:
        """Time from the timer's nominal tick to the end of each step that ran: `(steps,)`."""
        return frozen(self.finish_s[~self.skipped])

    @property
    def worst_s(self) -> float:
        """Latest end of a step after its tick."""
        return float(self.busy_s.max())

    @property
    def slack_s(self) -> float:
        """Time between the latest end of a step and the next tick, negative when one overran."""
        return self.period_s - self.worst_s

    @property
    def utilisation(self) -> float:
        """Share of the processor that an undisturbed frame and its background work take."""
        return self.times.step_s / self.period_s + self.frame.load

    @property
    def jitter_s(self) -> float:
        """Spread of the instants at which steps begin, largest less smallest."""
        began = self.start_s[~self.skipped]
        return float(np.ptp(began))

    @property
    def table(self) -> dict[str, float | int | str]:
        """What matters, by name; times in microseconds."""
        written = self.written_s[~self.skipped]
        done = self.done_s[np.isfinite(self.done_s)]
        us = 1e6
        return {
            "times": self.times.source,
            "ran": self.ran,
            "frames": self.frames,
            "period_us": round(us * self.period_s, 3),
            "step_us": round(us * self.times.step_s, 3),
            "utilisation_step": round(self.times.step_s / self.period_s, 4),
            "utilisation_with_background": round(self.utilisation, 4),
            "mean_latency_us": round(us * float(written.mean()), 3),
            "worst_latency_us": round(us * float(written.max()), 3),
            "start_jitter_us": round(us * self.jitter_s, 3),
            "worst_step_end_us": round(us * self.worst_s, 3),
            "slack_us": round(us * self.slack_s, 3),
            "worst_background_end_us": "late" if self.late_count else round(us * float(done.max()), 3),
            "overruns": self.overrun_count,
            "late_background_frames": self.late_count,
            "frames_out_of_control": int(np.count_nonzero(self.mode != ON)),
        }

    def timeline(self, k: int | None = None) -> str:
        """Return one frame as text, a line for each part, in microseconds after its tick.

        Args:
            k: number of the frame; the one whose step ends latest when absent.
        """
        number = self.worst_frame if k is None else whole("FrameSimulation", "k", k, 0, self.frames - 1)
        return "\n".join(_drawn(self, number))

    def spans_us(self, k: int) -> list[tuple[str, float, float]]:
        """Return the parts of frame k, which was not skipped: name, begin and end in microseconds after its tick."""
        return [(name, 1e6 * a, 1e6 * b) for name, a, b in _spans(self, k)]

    @property
    def worst_frame(self) -> int:
        """Number of the frame whose step ends latest after its tick."""
        return int(np.nanargmax(self.finish_s))


def judge(frame: FrameSettings, times: FrameTimes, law: Law, arrays: dict[str, Any], ran: str) -> FrameSimulation:
    """Return the arrays of a run as a result with its verdict."""
    period = 1.0 / law.rate_hz
    ticks = np.arange(arrays["skipped"].size) * period
    instants = {f"{name}_s": frozen(arrays[name] - ticks) for name in ("start", "written", "finish", "done")}
    flags = {name: frozen(arrays[name].astype(bool)) for name in ("skipped", "late")}
    counts = {name: frozen(arrays[name]) for name in ("mode", "faults", "level", "overruns")}
    status = _verdict(arrays, times, period, frame)
    return FrameSimulation(
        status,
        frame,
        times,
        period,
        **instants,
        **flags,
        **counts,
        largest_v=frozen(arrays["largest"]),
        hooked=arrays["hooked"],
        refused=arrays["refused"],
        ran=ran,
    )


def _verdict(arrays: dict[str, Any], times: FrameTimes, period: float, frame: FrameSettings) -> Status:
    frames, over = arrays["skipped"].size, int(arrays["overruns"][-1])
    late = int(np.count_nonzero(arrays["late"]))
    if over:
        first = int(np.argmax(arrays["skipped"]))
        mode = int(arrays["mode"][-1])
        after = "in control" if mode == ON else "in fault" if mode == FAULT else "out of control"
        sentence = f"{over} of {frames} frames overran, the first at frame {first}; the law ends {after}"
        if times.step_s >= period:
            sentence += f". Its step of {1e6 * times.step_s:.4g} us is longer than the frame: reduce the controller"
        return Status(StatusWord.OVERRUN, f"{sentence}.")
    if late:
        room = 1e6 * (1.0 - frame.load) * period
        return Status(
            StatusWord.BACKGROUND_LATE,
            f"No step overran, but background work was late in {late} of {frames} frames: it leaves {room:.4g} us of a"
            f" frame to the step, which takes {1e6 * times.step_s:.4g} us.",
        )
    return Status(StatusWord.OK, f"No overrun in {frames} frames, and background work was never late.")


def _spans(simulation: FrameSimulation, k: int) -> list[tuple[str, float, float]]:
    """Return the parts of frame k with begin and end in seconds after its tick."""
    start, written, finish, done = (
        float(a[k]) for a in (simulation.start_s, simulation.written_s, simulation.finish_s, simulation.done_s)
    )
    times = simulation.times
    idle = simulation.mode[k] == FAULT or (simulation.level[k] == 0 and simulation.mode[k] != ON)
    # What chance added between start and write is shared by the parts in proportion to their own times.
    parts = np.array([times.entry_s, times.read_s, times.idle_output_s if idle else times.output_s, times.write_s])
    ends = start + np.cumsum(parts) * ((written - start) / parts.sum() if parts.sum() else 0.0)
    names = ("interrupt entry", "converters read", "output", "converters write")
    rows = [(name, float(a), float(b)) for name, a, b in zip(names, (start, *ends[:-1]), ends, strict=True)]
    if start > 0.0:
        rows.insert(0, ("interrupt late", 0.0, start))
    rows.append(("update", written, finish))
    begins = finish + times.leave_s
    if np.isfinite(done) and simulation.frame.load > 0.0:
        rows.append(("background", begins, done))
    elif simulation.frame.load > 0.0:
        rows.append(("background, late", begins, max(begins, _next_start(simulation, k))))
    return rows


def _next_start(simulation: FrameSimulation, k: int) -> float:
    """Return when the next step begins, in seconds after the tick of frame k."""
    ran = np.flatnonzero(~simulation.skipped[k + 1 :])
    if not ran.size:
        return (simulation.frames - k) * simulation.period_s
    ahead = 1 + int(ran[0])
    return ahead * simulation.period_s + float(simulation.start_s[k + ahead])


def _drawn(simulation: FrameSimulation, k: int) -> list[str]:
    """Return the lines of the time line of frame k."""
    if simulation.skipped[k]:
        return [f"frame {k} was skipped: its interrupt met an unfinished step."]
    rows, period = simulation.spans_us(k), 1e6 * simulation.period_s
    span = max(period, *(end for _, _, end in rows))
    scale = WIDTH / span
    lines = [f"frame {k}: microseconds after its interrupt was due, one character is {1 / scale:.2f} us"]
    for name, a, b in rows:
        left = min(WIDTH - 1, round(a * scale))
        bar = " " * left + "#" * max(1, round(b * scale) - left)
        lines.append(f"{name:<17}|{bar[:WIDTH]:<{WIDTH}}| {a:8.2f} .. {b:8.2f}")
    mark = min(WIDTH - 1, round(period * scale))
    lines.append(f"{'next interrupt':<17} {' ' * mark}^ {period:.2f}")
    return lines
