"""Pacing: when the next frame of a bench begins, and which came too late."""

import time

SPIN_S = 1e-3  # what a sleep may oversleep on an ordinary kernel; the rest is waited for awake


class Pacer:
    """Frames at a rate, timed by this machine's clock.

    It is as punctual as Python on this machine: good for trials and slow benches. Hardware that has a clock of its own
    should pace the bench by `wait`. The first frame begins at once, or a period after `since_s` of that clock.
    """

    def __init__(self, rate_hz: float, since_s: float | None = None) -> None:
        self._period_s = 1.0 / rate_hz
        self._due_s = since_s

    def wait(self) -> int:
        """Wait for the next frame; return how many have been missed."""
        now = time.perf_counter()
        if self._due_s is None:
            self._due_s = now
            return 0
        self._due_s += self._period_s
        if now > self._due_s:
            missed = 1 + int((now - self._due_s) / self._period_s)
            self._due_s = now  # time that is lost is not made up for: frames would follow each other too fast
            return missed
        while (remaining_s := self._due_s - time.perf_counter()) > 0:
            if remaining_s > SPIN_S:
                time.sleep(remaining_s - SPIN_S)
        return 0
