"""The generated code's twin in NumPy: the same operations in the same order and precision, so the same bits."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.biquad import Bank
from ultraquiet.deploy.law import Law, Rounded

OFF, ON, STOPPING, FAULT = range(4)
FAULT_INPUT, FAULT_OUTPUT = 1, 2
COUNTER_MAX = 2**32 - 1


class Twin:
    """One instance of the law with its guards; the C function of each method bears the same name.

    Sums run from left to right, which `numpy.cumsum` keeps and `@` does not.
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        self._bank = Bank(law) if law.channels else None
        self._gain = np.concatenate([law.D, law.C], axis=1)
        self._groups = _groups(law)
        self._drive = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
        self._low, self._high = law.limits[:, 0].copy(), law.limits[:, 1].copy()
        self._ramp_step = law.dtype(1.0) / law.dtype(law.ramp_steps)
        self._seen = np.zeros(law.inputs + law.states, law.dtype)
        self.init()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    def init(self, hook: bool = False) -> None:
        """Return to rest, off, all counters zero; `hook` adds the self-test's overrun hook."""
        law = self.law
        self.x = np.zeros(law.states, law.dtype)
        self.y = np.zeros(law.inputs, law.dtype)
        self.raw = np.zeros(law.outputs, law.dtype)
        self.limited = np.zeros(law.outputs, law.dtype)
        self.applied = np.zeros(law.outputs, law.dtype)
        self.mode, self.faults, self.level, self.steps, self.clipped, self.overruns = OFF, 0, 0, 0, 0, 0
        self.live = self.busy = False
        self._hook = hook

    def reset(self) -> None:
        """Return to rest and take control at full command, as a `Controller` does."""
        self.init()
        self.enable()
        self.level = self.law.ramp_steps

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        with np.errstate(all="ignore"):
            u = self.output(np.asarray(y, self.law.dtype))
            self.update()
        return u.astype(np.float64)

    def run(self, y: ArrayLike) -> Rounded:
        """Return the commands `(nu, n)` in the code's precision for measurements `(ny, n)`."""
        given = np.ascontiguousarray(np.asarray(y, self.law.dtype).T)
        commands = np.empty((given.shape[0], self.law.outputs), self.law.dtype)
        with np.errstate(all="ignore"):
            for k, sample in enumerate(given):
                commands[k] = self.output(sample)
                self.update()
        return commands.T

    def enable(self) -> bool:
        """Ramp in; False while a fault is latched."""
        if self.mode == FAULT:
            return False
        self.mode = ON
        return True

    def disable(self) -> None:
        """Ramp out."""
        if self.mode == ON:
            self.mode = STOPPING

    def clear(self) -> bool:
        """Clear a latched fault once its ramp has ended."""
        if self.mode == FAULT and self.level == 0:
            self.mode, self.faults = OFF, 0
        return self.faults == 0

    def frame(self) -> bool:
        """Count an overrun when the last step is unfinished."""
        if not self.busy:
            return True
        self.overruns = min(self.overruns + 1, COUNTER_MAX)
        if self._hook:
            self.steps += 1000
        return False

    def output(self, y: NDArray[Any]) -> NDArray[Any]:
        """Return the commands of this step."""
        self.busy, self.live = True, False
        self.steps += 1
        if not np.isfinite(y).all():
            self._latch(FAULT_INPUT)
        elif self.mode in (ON, STOPPING):
            self.y = y
            self._law()
        self._ramp()
        return self.applied

    def update(self) -> None:
        """Advance the state."""
        if self.live:
            self._advance()
            self.live = False
        if self.mode == STOPPING and self.level == 0:
            self.mode = OFF
            self.x = np.zeros_like(self.x)
        self.busy = False

    def _law(self) -> None:
        raw = self._linear() if self._bank is None else self._bank.output(self.y, self.x)
        if not np.isfinite(raw).all():
            self._latch(FAULT_OUTPUT)
            return
        self.raw, self.live = raw, True
        self.limited = np.where(raw < self._low, self._low, np.where(raw > self._high, self._high, raw))
        if (self.limited != raw).any():
            self.clipped += 1

    def _linear(self) -> NDArray[Any]:
        self._seen[: self.y.size] = self.y
        self._seen[self.y.size :] = self.x
        return (self._gain * self._seen).cumsum(axis=1)[:, -1]

    def _advance(self) -> None:
        if self._bank is not None:
            self.x = self._bank.advance(self.y, self.x, self.limited - self.raw)
            return
        drive = self.y if self.law.L is None else np.concatenate([self.y, self.limited - self.raw])
        following = np.empty_like(self.x)
        for rows, A in self._groups:
            own = (A * self.x[rows][:, None, :]).reshape(-1, A.shape[2])
            flat = rows.ravel()
            following[flat] = np.concatenate([own, self._drive[flat] * drive], axis=1).cumsum(axis=1)[:, -1]
        self.x = self.x + following if self.law.delta else following

    def _latch(self, fault: int) -> None:
        self.faults |= fault
        self.mode = FAULT
        self.x = np.zeros_like(self.x)

    def _ramp(self) -> None:
        if self.mode == ON:
            self.level = min(self.level + 1, self.law.ramp_steps)
        elif self.level > 0:
            self.level -= 1
        if self.level == self.law.ramp_steps:
            self.applied = self.limited
        else:
            self.applied = self.limited * (self.law.dtype(self.level) * self._ramp_step)


def _groups(law: Law) -> list[tuple[NDArray[np.intp], Rounded]]:
    """Return for each size of block the states `(blocks, size)` and the stacked blocks `(blocks, size, size)`."""
    starts = np.cumsum([0, *(len(b) for b in law.blocks)])
    made = []
    for size in sorted({len(b) for b in law.blocks}):
        chosen = [k for k, b in enumerate(law.blocks) if len(b) == size]
        rows = np.array([np.arange(starts[k], starts[k] + size) for k in chosen], dtype=np.intp)
        made.append((rows, np.stack([law.blocks[k] for k in chosen])))
    return made
