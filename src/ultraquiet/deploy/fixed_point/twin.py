"""The integer code's twin in NumPy: the same whole numbers, step by step."""

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole


class FixedTwin(Shown):
    """One instance of a fixed-point law; the C function of each method bears the same name.

    A `Controller`: `step` takes and gives volts, through converters of the law's word and range.
    """

    def __init__(self, law: FixedLaw) -> None:
        self.law = law
        self._top = law.top
        self._of = np.arange(law.states) ^ 1
        pairs = law.A.reshape(-1, 4)
        # A block's row as what a state takes from itself and from its neighbour.
        self._self = pairs[:, [0, 3]].ravel()
        self._other = pairs[:, [1, 2]].ravel()
        self._shift_a = np.repeat(law.shift_a, 2)
        self.reset()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    def init(self) -> None:
        """Return to rest, off."""
        law = self.law
        self.x = np.zeros(law.states, np.int64)
        self.y = np.zeros(law.inputs, np.int64)
        self.level, self.on, self.clipped, self.limited = 0, False, 0, 0

    def reset(self) -> None:
        """Return to rest and take control at full command."""
        self.init()
        self.enable()
        self.level = 2**self.law.ramp_bits

    def enable(self) -> None:
        """Ramp in."""
        self.on = True

    def disable(self) -> None:
        """Ramp out."""
        self.on = False

    def output(self, y: Whole) -> Whole:
        """Return the commands of this step as words."""
        law = self.law
        self.y = np.asarray(y, np.int64)
        raw = _round(law.D @ self.y + self.x @ law.C, law.bits - 2 + law.shift_u)
        u = np.clip(raw, -self._top, self._top)
        self.clipped += bool(np.any(u != raw))
        full = 2**law.ramp_bits
        self.level = min(self.level + 1, full) if self.on else max(self.level - 1, 0)
        return u if self.level == full else _round(u * self.level, law.ramp_bits) if self.level else 0 * u

    def update(self) -> None:
        """Advance the state; at rest once the ramp has ended."""
        law = self.law
        x = self.following(self.x, self.y)
        if law.saturates:
            limited = np.clip(x, -self._top, self._top)
            self.limited += bool(np.any(limited != x))
            x = limited
        self.x = x if self.level or self.on else 0 * x

    def following(self, x: Whole, y: Whole) -> Whole:
        """Return what states `(n,)` and measurements `(ny,)` make of the states in one step, before any limit."""
        law = self.law
        own = _round(self._self * x + self._other * x[self._of], self._shift_a + 2)
        acc = own + _round(law.B @ y, law.shift_b + 2)
        return np.asarray(_round(acc, law.bits - 4) + (x if law.delta else 0))

    def run(self, y: ArrayLike) -> Whole:
        """Return the commands `(nu, n)` for measurements `(ny, n)`, both words."""
        samples = np.ascontiguousarray(np.asarray(y, np.int64).T)
        u = np.empty((len(samples), self.law.outputs), np.int64)
        for k, sample in enumerate(samples):
            u[k] = self.output(sample)
            self.update()
        return u.T

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        u = self.output(words(y, self.law.input_v, self.law.bits))
        self.update()
        return u.astype(np.float64) * (self.law.output_v / 2.0 ** (self.law.bits - 1))


def words(y: ArrayLike, range_v: float, bits: int) -> Whole:
    """Return volts as a converter of this range and word gives them, saturated at its ends.

    Raises:
        InputError: NaN, for which no converter has a code.
    """
    if np.any(np.isnan(y)):
        raise InputError("deploy: a measurement that is NaN has no code; check the sensors.")
    top = 2 ** (bits - 1) - 1
    return np.clip(np.rint(np.asarray(y) * (2.0 ** (bits - 1) / range_v)), -top, top).astype(np.int64)


def _round(value: Whole, shift: Whole | int) -> Whole:
    """Return floor(value / 2^shift + 1/2); the shift of a negative number is arithmetic here, as in the code."""
    half = np.left_shift(np.int64(1), np.asarray(shift, np.int64) - 1) if np.all(np.asarray(shift) > 0) else 0
    return np.right_shift(value + half, shift)
