"""The law in the C31's arithmetic: what the emitted frame computes, written from the equations."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c31.arithmetic import added, multiplied, rounded, stored, summed
from ultraquiet.deploy.c31.float_format import decode, encode
from ultraquiet.deploy.law.law import Law


class C31Twin(Shown):
    """One instance of the frame; numbers are float64 that hold words of the C31.

    Args:
        law: in modal, delta or bank form.
        limits: of each command in volts, `(nu, 2)`, the actuator's and the converter's.
        volts_per_count: of the reading converters.
        counts_per_volt: of the writing converters.
    """

    def __init__(self, law: Law, limits: FloatArray, volts_per_count: float, counts_per_volt: float) -> None:
        self.law = law
        self.limits = decode(encode(limits))
        self._read, self._write = (decode(encode(scale)) for scale in (volts_per_count, counts_per_volt))
        self._gain = np.concatenate([law.C, law.D], axis=1).astype(np.float64)
        self._own = np.concatenate(law.blocks, axis=0).astype(np.float64)
        drive = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
        self._drive = drive.astype(np.float64)
        self._channel = np.repeat(np.arange(len(law.channels)), 2 * np.array(law.channels, dtype=int))
        # Rows of C and D are taken from end to end and back; the last one always forwards.
        self._backwards = (law.outputs - np.arange(law.outputs)) % 2 == 1
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self.x = np.zeros(self.law.states)
        self.u = np.zeros(self.law.outputs)

    def frame(self, counts: ArrayLike) -> NDArray[np.int64]:
        """Return the codes `(nu,)` for converters that read `counts` `(ny,)`; `u` and `x` are those after it."""
        y = self.read(counts)
        self.u = self.output(y)
        limited = np.clip(self.u, self.limits[:, 0], self.limits[:, 1])
        self.update(y, self.u, limited)
        return np.floor(multiplied(limited, self._write)).astype(np.int64)

    def read(self, counts: ArrayLike) -> FloatArray:
        """Return the measurements `(ny,)` in volts for codes of the reading converters."""
        return stored(multiplied(np.asarray(counts, np.float64), self._read))

    def output(self, y: FloatArray) -> FloatArray:
        """Return D y + C x."""
        if self.law.channels:
            return rounded(np.array([self._of_channel(c, y[c]) for c in range(len(y))]))
        products = multiplied(self._gain, np.concatenate([self.x, y]))
        return rounded(summed(np.where(self._backwards[:, None], products[:, ::-1], products)))

    def _of_channel(self, c: int, y: float) -> float:
        own = self._channel == c
        gains = np.append(self.law.C[c, own], self.law.D[c, c]).astype(np.float64)
        return float(summed(multiplied(gains, np.append(self.x[own], y))[None, :])[0])

    def update(self, y: FloatArray, raw: FloatArray, limited: FloatArray) -> None:
        """Advance: own state, first measurement, other state, other measurements, corrections."""
        seen = y if self.law.L is None else np.concatenate([y, stored(added(limited, -raw))])
        pair = np.repeat(self.x.reshape(-1, 2), 2, axis=0)
        own, drive = multiplied(self._own, pair), multiplied(self._drive, seen)
        if self.law.channels:
            mine = [self._channel] if self.law.L is None else [self._channel, self._channel + len(y)]
            drive = np.stack([drive[np.arange(len(self.x)), columns] for columns in mine], axis=1)
        total = summed(np.concatenate([own[:, :1], drive[:, :1], own[:, 1:], drive[:, 1:]], axis=1))
        self.x = rounded(added(self.x, total) if self.law.delta else total)
