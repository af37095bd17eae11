"""Plain twin of the frame harness: the same instants, one frame a call, around any object with the code's functions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet.deploy.frame.settings import Draws
from ultraquiet.deploy.law.twin import ON, STOPPING


class FrameClock:
    """Time on one processor; `code` has `frame`, `output`, `update`, `clear`, `enable`, `mode`, `level`.

    Every sum is formed as in the harness, so the instants have the same bits.
    """

    def __init__(self, code: Any, settings: dict[str, Any], draws: Draws) -> None:
        self.code, self.t, self.draws = code, settings, draws
        self.finish = self.last = self.blocked = self.backlog = 0.0
        self.written = self.start = 0.0
        self.clean = self.open_at = self.refused = self._arrival = 0
        self.open = False

    def tick(self, k: int, y: NDArray[Any]) -> tuple[bool, float, float]:
        """Return for frame k: whether it was skipped, its step's end so far, when background work was done (or -1)."""
        now = max(self.last, k * self.t["period_s"] + float(self.draws.delay_s[k]))
        self.last = now
        skipped, done = self.open and now < self.finish, -1.0
        if skipped:
            self.refused += self.code.frame()
            visit = self.t["entry_s"] + self.t["leave_s"]
            self.written = self.written + visit if now < self.written else self.written
            self.finish = self._spend(self.finish, visit)
            self.clean = 0
        else:
            done = self.close(now)
        self.late = self.backlog > 0.0
        self.backlog = self.backlog + self.t["background_s"]
        if not skipped:
            self._begin(k, now, y)
        return skipped, self.finish, done

    def close(self, now: float) -> float:
        """End the step under way and do background work until `now`; return when that was done, or -1."""
        if self.open:
            self.code.update()
            self.open = False
            self.blocked = self._spend(self.finish, self.t["leave_s"])
        return self._gap(now)

    def _begin(self, k: int, now: float, y: NDArray[Any]) -> None:
        t, stretch = self.t, float(self.draws.stretch[k])
        if t["restart"] > 0 and self.clean >= t["restart"] and self.code.level == 0:
            self.code.clear()
            self.code.enable()
        self.refused += not self.code.frame()
        idle = "" if self.code.mode in (ON, STOPPING) else "idle_"
        self.start = max(now, self.blocked)
        end = self._spend(self.start, t["entry_s"])
        end = self._spend(end, stretch * (t["read_s"] + t[f"{idle}output_s"]))
        self.command = self.code.output(y)
        self.written = self._spend(end, stretch * t["write_s"])
        self.finish = self._spend(self.written, stretch * t[f"{idle}update_s"] + float(self.draws.extra_s[k]))
        self.open, self.open_at = True, k
        self.clean += 1

    def _spend(self, t: float, work: float) -> float:
        end, arrivals = t + work, self.draws.arrival_s
        while self._arrival < arrivals.size and arrivals[self._arrival] < end:
            end = end + self.t["service_s"]
            self._arrival += 1
        return end

    def _gap(self, now: float) -> float:
        t, done, arrivals = self.blocked, -1.0, self.draws.arrival_s
        while True:
            met = self._arrival < arrivals.size and arrivals[self._arrival] < now
            end = float(arrivals[self._arrival]) if met else now
            if end > t:
                if done < 0.0 and self.backlog <= end - t:
                    done, self.backlog = t + self.backlog, 0.0
                elif done < 0.0:
                    self.backlog = self.backlog - (end - t)
                t = end
            if not met:
                break
            t = t + self.t["service_s"]
            self._arrival += 1
        self.blocked = self._spend(t, 0.0)
        return done


def empty_arrays(frames: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of a run, as neither harness nor clock has filled them: NaN where nothing happened."""
    instants = {name: np.full(frames, np.nan) for name in ("start", "written", "finish", "done", "largest")}
    flags = {name: np.zeros(frames, np.uint8) for name in ("mode", "faults", "skipped", "late")}
    return instants | flags | {name: np.zeros(frames, np.uint32) for name in ("level", "overruns")}


def run_clock(clock: FrameClock, frames: int, y: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the arrays of `frames` frames, y being `(samples, inputs)` and repeated."""
    arrays, code = empty_arrays(frames), clock.code
    for k in range(frames):
        before, end = clock.open_at, clock.finish
        skipped, _, done = clock.tick(k, y[k % len(y)])
        arrays["skipped"][k] = skipped
        arrays["written"][clock.open_at] = clock.written
        if not skipped:
            arrays["start"][k] = clock.start
            if k:
                arrays["finish"][before] = end
            if done >= 0.0:
                arrays["done"][before] = done
        if k:
            arrays["late"][k - 1] = clock.late
        for name in ("mode", "faults", "level", "overruns"):
            arrays[name][k] = getattr(code, name)
        arrays["largest"][k] = np.abs(clock.command).max()
    end = clock.finish
    done = clock.close(frames * clock.t["period_s"])
    arrays["finish"][clock.open_at] = end
    if done >= 0.0:
        arrays["done"][clock.open_at] = done
    arrays["late"][frames - 1] = clock.backlog > 0.0
    return arrays
