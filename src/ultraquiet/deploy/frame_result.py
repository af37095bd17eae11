"""What a simulation of frames has found: instants, counters, a verdict, and the time line in words."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray, frozen
from ultraquiet.deploy.frame import Frame
from ultraquiet.deploy.frame_times import FrameTimes
from ultraquiet.deploy.law import Law
from ultraquiet.deploy.twin import FAULT, ON
from ultraquiet.values.status import Status

WIDTH = 60  # characters of a period in the time line


@dataclass(frozen=True, eq=False)
class FrameSimulation:
    """Frames one by one. Instants are seconds after the timer's nominal tick of their frame; NaN in skipped frames.

    `start_s` the step begins, `written_s` the converters hold the new command, `finish_s` the busy flag falls,
    `done_s` background work has caught up. `skipped` marks frames whose interrupt met an unfinished step, `late` frames
    that end with background work undone. `mode`, `faults`, `level` and `overruns` are the code's own after each frame,
    `largest_v` is the largest command. `hooked` counts calls of the overrun hook (None for the twin), `refused` those
    calls of `NAME_frame` whose answer was not the one expected (zero, or the code is wrong). `ran` says what was run.
    """

    status: Status
    frame: Frame
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
            "worst_background_end_us": round(us * float(done.max()), 3) if done.size else "never",
            "overruns": self.overrun_count,
            "late_background_frames": self.late_count,
            "frames_out_of_control": int(np.count_nonzero(self.mode != ON)),
        }

    def timeline(self, k: int | None = None) -> str:
        """Return one frame as text, a line for each part, in microseconds after its tick.

        Args:
            k: number of the frame; the one whose step ends latest when absent.
        """
        return "\n".join(timeline_rows(self, self.worst_frame if k is None else k))

    @property
    def worst_frame(self) -> int:
        """Number of the frame whose step ends latest after its tick."""
        return int(np.nanargmax(self.finish_s))


def judge(frame: Frame, times: FrameTimes, law: Law, held: dict[str, Any], ran: str) -> FrameSimulation:
    """Return the arrays of a run as a result with its verdict."""
    period = 1.0 / law.rate_hz
    ticks = np.arange(held["skipped"].size) * period
    arrays = {f"{name}_s": frozen(held[name] - ticks) for name in ("start", "written", "finish", "done")}
    flags = {name: frozen(held[name].astype(bool)) for name in ("skipped", "late")}
    counts = {name: frozen(held[name]) for name in ("mode", "faults", "level", "overruns")}
    status = _verdict(held, times, period, frame)
    return FrameSimulation(
        status,
        frame,
        times,
        period,
        **arrays,
        **flags,
        **counts,
        largest_v=frozen(held["largest"]),
        hooked=held["hooked"],
        refused=held["refused"],
        ran=ran,
    )


def _verdict(held: dict[str, Any], times: FrameTimes, period: float, frame: Frame) -> Status:
    frames, over = held["skipped"].size, int(held["overruns"][-1])
    late = int(np.count_nonzero(held["late"]))
    if over:
        first = int(np.argmax(held["skipped"]))
        mode = int(held["mode"][-1])
        after = "in control" if mode == ON else "in fault" if mode == FAULT else "out of control"
        sentence = f"{over} of {frames} frames overran, the first at frame {first}; the law ends {after}"
        if times.step_s >= period:
            sentence += f". Its step of {1e6 * times.step_s:.4g} us is longer than the frame: reduce the controller"
        return Status("overrun", f"{sentence}.")
    if late:
        room = 1e6 * (1.0 - frame.load) * period
        return Status(
            "background late",
            f"No step overran, but background work was late in {late} of {frames} frames: it leaves {room:.4g} us of a"
            f" frame to the step, which takes {1e6 * times.step_s:.4g} us.",
        )
    return Status("ok", f"No overrun in {frames} frames, and background work was never late.")


def timeline_rows(found: FrameSimulation, k: int) -> list[str]:
    """Return the lines of the time line of frame k."""
    if found.skipped[k]:
        return [f"frame {k} was skipped: its interrupt met an unfinished step."]
    start, written, finish, done = (
        float(1e6 * a[k]) for a in (found.start_s, found.written_s, found.finish_s, found.done_s)
    )
    times, period = found.times, 1e6 * found.period_s
    idle = found.mode[k] == FAULT or (found.level[k] == 0 and found.mode[k] != ON)
    # What chance added between start and write is shared by the parts in proportion to their own times.
    parts = np.array([times.entry_s, times.read_s, times.idle_output_s if idle else times.output_s, times.write_s])
    share = (written - start) / (1e6 * parts.sum()) if parts.sum() else 0.0
    ends = start + np.cumsum(1e6 * parts) * share
    rows = [("interrupt late", 0.0, start)] if start > 0.0 else []
    names = ("interrupt entry", "converters read", "output", "converters write")
    rows += [(name, float(a), float(b)) for name, a, b in zip(names, (start, *ends[:-1]), ends, strict=True)]
    rows.append(("update", written, finish))
    begins = finish + 1e6 * times.leave_s
    rows.append(("background", begins, done if np.isfinite(done) else max(period, begins)))
    span = max(period, *(end for _, _, end in rows))
    scale = WIDTH / span
    said = [f"frame {k}: {span:.1f} us on {WIDTH} characters, the next interrupt at {period:.1f} us"]
    for name, a, b in rows:
        left, right = round(a * scale), round(b * scale)
        bar = " " * left + "#" * max(1, right - left)
        said.append(f"{name:<17}|{bar[:WIDTH]:<{WIDTH}}| {a:8.2f} .. {b:8.2f}")
    mark = min(WIDTH - 1, round(period * scale))
    said.append(" " * 18 + " " * mark + "^ next interrupt")
    return said
