"""A channel of classical sections in series as a tunable part: lead-lag, notch, corners, a gain."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg import realize
from ultraquiet.linalg.ordered import Matrices

LOG_LIMIT = 12.0  # corners stay within e^12 of where they began: further is nowhere
SECTION_SIZES = {"lead-lag": 2, "notch": 3, "biquad": 4, "high-pass": 1, "low-pass": 1}


@dataclass(frozen=True, eq=False)
class SectionCascade:
    """One channel of sections in series, k = gain prod section: stable and of minimum phase whatever the parameters.

    `lead-lag` (zero, pole): (1 + s/z) / (1 + s/p). `notch` (w, zeta_z, zeta_p), gain one on both sides. `biquad` (w_z,
    zeta_z, w_p, zeta_p), gain one at high frequency. `high-pass` s / (s + w), `low-pass` w / (s + w).

    Args:
        kinds: one word a section.
        gain: scale of the gain, its sign inside.
        values: where the parameters of every section begin, positive, as many as the kinds take.
        free: which of the values may move; all when absent.
    """

    kinds: tuple[str, ...]
    gain: float
    values: tuple[float, ...]
    free: tuple[bool, ...] | None = None
    shape: tuple[int, int] = field(default=(1, 1), init=False)

    @property
    def size(self) -> int:
        """Number of parameters: the gain first, then logarithms of the free values over where they began."""
        return 1 + int(self._moving.sum())

    @cached_property
    def _moving(self) -> np.ndarray:
        return np.ones(len(self.values), bool) if self.free is None else np.array(self.free, bool)

    @property
    def origin(self) -> FloatArray:
        """The parameters that stand for `gain` and `values`."""
        return np.append(1.0, np.zeros(self.size - 1))

    def numbers(self, theta: FloatArray) -> FloatArray:
        """Return the values of all sections."""
        logs = np.zeros(len(self.values))
        logs[self._moving] = np.clip(theta[1:], -LOG_LIMIT, LOG_LIMIT)
        return np.array(self.values) * np.exp(logs)

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, 1, 1)`."""
        k = np.full(s.shape, self.gain * theta[0], dtype=np.complex128)
        for num, den in self._polynomials(theta):
            k *= np.polyval(num, s) / np.polyval(den, s)
        return k[:, None, None]

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        unit = theta.copy()
        unit[0] = 1.0
        shape = self.response(unit, s)[:, 0, 0]
        columns: list[ComplexArray] = []
        at, numbers = 0, self.numbers(theta)
        for kind in self.kinds:
            n = SECTION_SIZES[kind]
            columns += _log_slopes(kind, numbers[at : at + n], s)
            at += n
        logs = np.array(columns).reshape(len(self.values), s.size).T[:, self._moving]
        slopes = np.hstack([np.ones((s.size, 1)), theta[0] * logs]) * shape[:, None]
        return slopes * (left[:, 0] * right[:, 0])[:, None]

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        return np.append(theta[0] * factor, theta[1:])

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        M = realize.sections(np.array([self.gain * theta[0]]), np.ones(1))
        for num, den in self._polynomials(theta):
            M = _series(M, _section(num, den))
        return M

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change is: the gain's own size, one for logarithms."""
        return np.append(max(abs(float(theta[0])), 1e-3), np.ones(self.size - 1))

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return the values given, moved at random by a factor of two or so."""
        theta = self.origin
        theta[0] *= np.exp(rng.normal())
        theta[1:] = 0.7 * rng.standard_normal(self.size - 1)
        return theta

    def _polynomials(self, theta: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        numbers, at, out = self.numbers(theta), 0, []
        for kind in self.kinds:
            n = SECTION_SIZES[kind]
            out.append(_polynomial(kind, numbers[at : at + n]))
            at += n
        return out


def _polynomial(kind: str, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    if kind == "lead-lag":
        return np.array([v[1] / v[0], v[1]]), np.array([1.0, v[1]])
    if kind == "high-pass":
        return np.array([1.0, 0.0]), np.array([1.0, v[0]])
    if kind == "low-pass":
        return np.array([v[0]]), np.array([1.0, v[0]])
    wz, zz, wp, zp = v if kind == "biquad" else (v[0], v[1], v[0], v[2])
    return np.array([1.0, 2 * zz * wz, wz * wz]), np.array([1.0, 2 * zp * wp, wp * wp])


def _log_slopes(kind: str, v: FloatArray, s: ComplexArray) -> list[ComplexArray]:
    """Return d log(section) / d log(value) for every value."""
    if kind == "lead-lag":
        return [-s / (s + v[0]), s / (s + v[1])]
    if kind == "high-pass":
        return [-v[0] / (s + v[0])]
    if kind == "low-pass":
        return [s / (s + v[0])]
    wz, zz, wp, zp = v if kind == "biquad" else (v[0], v[1], v[0], v[2])
    num, den = s * s + 2 * zz * wz * s + wz * wz, s * s + 2 * zp * wp * s + wp * wp
    w_up, z_up = (2 * zz * wz * s + 2 * wz * wz) / num, 2 * zz * wz * s / num
    w_down, z_down = -(2 * zp * wp * s + 2 * wp * wp) / den, -2 * zp * wp * s / den
    return [w_up, z_up, w_down, z_down] if kind == "biquad" else [w_up + w_down, z_up, z_down]


def _section(num: FloatArray, den: FloatArray) -> Matrices:
    n = len(den) - 1
    return realize.sections(np.concatenate([np.zeros(n + 1 - len(num)), num]), den)


def _series(first: Matrices, second: Matrices) -> Matrices:
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    A = np.block([[a1, np.zeros((a1.shape[0], a2.shape[0]))], [b2 @ c1, a2]])
    return A, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1
