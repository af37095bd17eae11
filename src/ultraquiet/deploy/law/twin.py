"""The generated code's twin in NumPy: the same operations in the same order and precision, so the same bits."""

import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray, few_finite
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.law.biquad import BankArithmetic
from ultraquiet.deploy.law.coefficients import numbers, with_numbers
from ultraquiet.deploy.law.law import Law, Rounded

OFF, ON, STOPPING, FAULT = range(4)
FAULT_INPUT, FAULT_OUTPUT, FAULT_OVERRUN = 1, 2, 4
SWAP_NONE, SWAP_KEEP, SWAP_RAMP = range(3)
SIGNALS = ("nothing", "y", "x", "raw", "excitation", "limited", "applied")
TAPS = 4
COUNTER_MAX = 2**32 - 1


class Twin(Shown):
    """One instance of the law with its guards; the C function of each method bears the same name.

    Sums run from left to right, which `numpy.cumsum` keeps and `@` does not.
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        self._ramp_step = law.dtype(1.0) / law.dtype(law.ramp_steps)
        self._seen = np.zeros(law.inputs + law.states, law.dtype)
        self.init()

    def _take(self, law: Law, bank: int) -> None:
        """Put the coefficients of a law into use; `bank` is 0 for the built-in ones, else 1 or 2."""
        self.bank = bank
        self._bank = BankArithmetic(law) if law.channels else None
        self._gain = np.concatenate([law.D, law.C], axis=1)
        drive = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
        self._groups = [_Group(rows, blocks, drive[rows.ravel()]) for rows, blocks in _groups(law)]
        self.numbers = numbers(law)

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
        self.excitation = np.zeros(law.outputs, law.dtype)
        self.limited = np.zeros(law.outputs, law.dtype)
        self.cut = np.zeros(law.outputs, law.dtype)
        self.applied = np.zeros(law.outputs, law.dtype)
        self.mode, self.faults, self.level, self.steps, self.clipped = OFF, 0, 0, 0, 0
        self.overruns, self.late, self.swapping = 0, 0, SWAP_NONE
        self.live = self.busy = self.stalled = self.resume = self.attached = self.loaded = False
        self.taps = [(0, 0)] * TAPS
        self._hook = hook
        self._low, self._high = law.limits[:, 0].copy(), law.limits[:, 1].copy()
        self._take(law, 0)

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
        samples = np.ascontiguousarray(np.asarray(y, self.law.dtype).T)
        commands = np.empty((samples.shape[0], self.law.outputs), self.law.dtype)
        with np.errstate(all="ignore"):
            for k, sample in enumerate(samples):
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
        self.resume = False
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
            self.late = max(self.late - 1, 0)
            return True
        self.overruns = min(self.overruns + 1, COUNTER_MAX)
        self.late += 2
        if self.late >= 2 * self.law.overrun_limit:
            self.late, self.stalled = 0, True
        if self._hook:
            self.steps += 1000
        return False

    def narrow(self, channel: int) -> None:
        """Cut the limits of one channel to a millionth, for the self-test."""
        self._low[channel] *= self.law.dtype(2.0**-20)
        self._high[channel] *= self.law.dtype(2.0**-20)

    def excite(self, volts: ArrayLike) -> bool:
        """Set what is added to the commands before the limits `(nu,)`; none, and False, for NaN or infinity."""
        asked_v = np.asarray(volts, self.law.dtype)
        if not np.isfinite(asked_v).all():
            self.excitation = np.zeros_like(asked_v)
            return False
        low, high = self.law.excitation.T
        above = np.where(asked_v < low, low, asked_v)
        self.excitation = np.where(above > high, high, above)
        return True

    def attach(self) -> None:
        """Give memory for banks, and return to the built-in coefficients."""
        self.loaded, self.swapping, self.attached = False, SWAP_NONE, True
        self._take(self.law, 0)

    def load_bank(self, words: ArrayLike, crc: int) -> bool:
        """Take coefficients as 32-bit words with their CRC-32; False when they are not sound.

        Raises:
            InputError: another number of words, which the code has no room for: that of another law or precision.
        """
        given = np.asarray(words)
        count = self.numbers.nbytes // 4
        whole = given.dtype.kind in "iu" and given.shape == (count,)
        if not whole or given.min() < 0 or given.max() > COUNTER_MAX:
            raise InputError(
                f"deploy: a bank of this code is {count} whole numbers of 32 bits, got {given.dtype} of shape "
                f"{given.shape}{' beyond that' if whole else ''}."
            )
        if not self.attached or self.swapping != SWAP_NONE:
            return False
        self.loaded = False
        raw = given.astype("<u4").tobytes()
        row = np.frombuffer(raw, np.dtype(self.law.dtype).newbyteorder("<")).astype(self.law.dtype)
        if zlib.crc32(raw) != crc or not np.isfinite(row).all():
            return False
        self._loaded, self.loaded = row, True
        return True

    def swap(self, keep: bool) -> bool:
        """Put the loaded bank into use between two steps: with the state kept, or by a ramp out and in."""
        if not self.loaded:
            return False
        self.loaded = False
        self.swapping = SWAP_KEEP if keep else SWAP_RAMP
        return True

    def select(self, tap: int, signal: int, channel: int) -> bool:
        """Choose what a tap shows."""
        values = getattr(self, SIGNALS[signal]) if 0 < signal < len(SIGNALS) else None
        if tap >= TAPS or (values is not None and channel >= values.size):
            return False
        self.taps[tap] = (0, 0) if values is None else (signal, channel)
        return values is not None or signal == 0

    def monitor(self) -> Rounded:
        """Return the present values of the chosen signals `(4,)`."""
        zero = self.law.dtype(0.0)
        return np.array([getattr(self, SIGNALS[s])[c] if s else zero for s, c in self.taps], self.law.dtype)

    def output(self, y: NDArray[Any]) -> NDArray[Any]:
        """Return the commands of this step."""
        self.busy, self.live = True, False
        self.steps += 1
        if self.stalled:
            self.stalled = False
            self._latch(FAULT_OVERRUN)
        if not few_finite(y):
            self._latch(FAULT_INPUT)
        elif self.mode in (ON, STOPPING):
            self.y = y
            self._law()
        self._ramp()
        return self.applied

    def update(self) -> None:
        """Advance the state."""
        if self.live and (self.mode == ON or self.level != 0):
            self._advance()
        self.live = False
        self._boundary()
        self.busy = False

    def _boundary(self) -> None:
        if self.swapping == SWAP_RAMP and self.mode == ON:
            self.mode, self.resume = STOPPING, True
        if self.swapping == SWAP_KEEP or (self.swapping == SWAP_RAMP and self.level == 0):
            self._take(with_numbers(self.law, self._loaded), 2 if self.bank == 1 else 1)
            self.swapping = SWAP_NONE
        if self.mode == STOPPING and self.level == 0:
            self.mode = ON if self.resume else OFF
            self.resume = False
            self.x = np.zeros_like(self.x)

    def _law(self) -> None:
        raw = self._linear() if self._bank is None else self._bank.output(self.y, self.x)
        if not few_finite(raw):
            self._latch(FAULT_OUTPUT)
            return
        self.raw, self.live = raw, True
        asked_v = raw + self.excitation
        above = np.where(asked_v < self._low, self._low, asked_v)
        self.limited = np.where(above > self._high, self._high, above)
        self.cut = self.limited - asked_v
        self.clipped += int((self.limited != asked_v).any())

    def _linear(self) -> NDArray[Any]:
        self._seen[: self.y.size] = self.y
        self._seen[self.y.size :] = self.x
        return (self._gain * self._seen).cumsum(axis=1)[:, -1]

    def _advance(self) -> None:
        if self._bank is not None:
            self.x = self._bank.advance(self.y, self.x, self.cut)
            return
        drive = self.y if self.law.L is None else np.concatenate([self.y, self.cut])
        following = np.empty_like(self.x)
        for group in self._groups:
            following[group.rows] = group.following(self.x, drive)
        self.x = self.x + following if self.law.delta else following

    def _latch(self, fault: int) -> None:
        self.faults |= fault
        self.mode, self.resume = FAULT, False
        self.x = np.zeros_like(self.x)
        self.excitation = np.zeros_like(self.excitation)

    def _ramp(self) -> None:
        if self.mode == ON:
            self.level = min(self.level + 1, self.law.ramp_steps)
        elif self.level > 0:
            self.level -= 1
        if self.level == self.law.ramp_steps:
            self.applied = self.limited
        else:
            self.applied = self.limited * (self.law.dtype(self.level) * self._ramp_step)


class _Group:
    """The blocks of one size: their products stand side by side, so that one sum runs over each row of them."""

    def __init__(self, rows: NDArray[np.intp], blocks: Rounded, drive: Rounded) -> None:
        count, size = rows.shape
        self.rows, self._states, self._blocks = rows.ravel(), rows, blocks
        self._drive = drive.reshape(count, size, -1)
        self._products = np.empty((count, size, size + drive.shape[1]), blocks.dtype)

    def following(self, x: NDArray[Any], drive: NDArray[Any]) -> NDArray[Any]:
        """Return A x + [B L] drive of these states, summed from left to right."""
        size = self._blocks.shape[2]
        np.multiply(self._blocks, x[self._states][:, None, :], out=self._products[:, :, :size])
        np.multiply(self._drive, drive, out=self._products[:, :, size:])
        return self._products.cumsum(axis=2)[:, :, -1].ravel()


def _groups(law: Law) -> list[tuple[NDArray[np.intp], Rounded]]:
    """Return for each size of block the states `(blocks, size)` and the stacked blocks `(blocks, size, size)`."""
    starts = np.cumsum([0, *(len(b) for b in law.blocks)])
    groups = []
    for size in sorted({len(b) for b in law.blocks}):
        chosen = [k for k, b in enumerate(law.blocks) if len(b) == size]
        rows = np.array([np.arange(starts[k], starts[k] + size) for k in chosen], dtype=np.intp)
        groups.append((rows, np.stack([law.blocks[k] for k in chosen])))
    return groups
