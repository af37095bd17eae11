"""A channel of second-order sections in series as a tunable part: stable, zeros anywhere, good over many decades."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.linalg.zeros import invariant_zeros

FASTEST = 13.0  # logarithms of frequencies and dampings stay within this of zero
PER_SECTION = 5  # parameters
FREE = 0.25  # of the floor, which e^q makes up by itself
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Biquads:
    """Sections in series, k = prod (b2 s^2 + b1 v s + b0 v^2) / (s^2 + 2 zeta w s + w^2).

    w = e^p and zeta = 3/4 floor + e^q with e^q >= 1/4 floor: stable and damped by the floor at least, whatever the
    parameters, and a section at the floor still feels that q would lead away from it. The gain of a product is as
    easily set where it is 10^5 times smaller than elsewhere; in a sum of sections the parts would have to cancel there.

    Args:
        scales: v, `(sections,)`, about the frequency of each section's zeros.
        floor: least damping ratio of poles.
    """

    scales: FloatArray
    floor: float
    shape: tuple[int, int] = (1, 1)

    @property
    def size(self) -> int:
        """Number of parameters: p, q, b2, b1, b0 of each section."""
        return PER_SECTION * self.scales.size

    @property
    def lowest(self) -> FloatArray:
        """Least values of the parameters: those of q; others have none."""
        least = np.full((self.scales.size, PER_SECTION), -np.inf)
        least[:, 1] = np.log(FREE * self.floor)
        return least.ravel()

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, 1, 1)`."""
        N, den = self._polynomials(theta, s)
        return np.prod(N / den, axis=1)[:, None, None]

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        N, den = self._polynomials(theta, s)
        w, _, extra = self._poles(theta)
        each = N / den
        before = np.cumprod(np.hstack([np.ones((s.size, 1)), each[:, :-1]]), axis=1)
        after = np.cumprod(np.hstack([np.ones((s.size, 1)), each[:, :0:-1]]), axis=1)[:, ::-1]
        others = before * after * (left[:, 0] * right[:, 0])[:, None]
        zeta = (1 - FREE) * self.floor + extra
        s1 = s[:, None]
        by_p = -others * each * (2 * zeta * w * s1 + 2 * w**2) / den
        by_q = -others * each * (2 * extra * w * s1) / den
        v = self.scales
        by_b = [others / den * term for term in (s1**2, v * s1, v**2 * np.ones_like(s1))]
        return np.stack([by_p, by_q, *by_b], axis=2).reshape(s.size, self.size)

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        w, zeta, _ = self._poles(theta)
        b = theta.reshape(-1, PER_SECTION)[:, 2:]
        v = self.scales
        M: Matrices | None = None
        for i in np.argsort(w, kind="stable"):
            num = np.array([b[i, 0], b[i, 1] * v[i], b[i, 2] * v[i] ** 2])
            one = _section(num, float(w[i]), float(zeta[i]))
            M = one if M is None else _in_series(M, one)
        return M or (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        out = theta.copy()
        out[2:PER_SECTION] *= factor
        return out

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change is: one for logarithms, its share of the section's numerator for the others."""
        own = np.ones((self.scales.size, PER_SECTION))
        b = np.abs(theta.reshape(-1, PER_SECTION)[:, 2:])
        own[:, 2:] = np.maximum(b, LEAST_SHARE * b.max(axis=1, keepdims=True))
        return own.ravel()

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start with poles between two frequencies."""
        n = self.scales.size
        theta = np.zeros((n, PER_SECTION))
        theta[:, 0] = rng.uniform(np.log(low), np.log(high), n)
        theta[:, 1] = np.log(rng.uniform(0.2, 1.0, n))
        theta[:, 2:] = 1 + 0.3 * rng.standard_normal((n, 3))
        return theta.ravel()

    def _poles(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return frequencies, damping ratios and what of these is above the floor."""
        p, q = (np.clip(theta[k::PER_SECTION], -FASTEST, FASTEST) for k in (0, 1))
        extra = np.maximum(np.exp(q), FREE * self.floor)
        return np.exp(p), (1 - FREE) * self.floor + extra, extra

    def _polynomials(self, theta: FloatArray, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        w, zeta, _ = self._poles(theta)
        b2, b1, b0 = (theta[k::PER_SECTION] for k in (2, 3, 4))
        v, s1 = self.scales, s[:, None]
        return (b2 * s1 + b1 * v) * s1 + b0 * v**2, (s1 + 2 * zeta * w) * s1 + w**2


LEAST_SHARE = 0.05  # of a numerator's largest coefficient: a smaller one moves by as much


def _section(num: FloatArray, w: float, zeta: float) -> Matrices:
    """Return one section with states of alike size, A = [[0, w], [-w, -2 zeta w]]."""
    d = num[0]
    rest = np.array([num[1] - 2 * zeta * w * d, num[2] - w * w * d])  # of s and of 1
    root = np.sqrt(w)
    A = np.array([[0.0, w], [-w, -2 * zeta * w]])
    return A, np.array([[0.0], [root]]), np.array([[rest[1] / w / root, rest[0] / root]]), np.array([[d]])


def _in_series(first: Matrices, second: Matrices) -> Matrices:
    """Return second after first."""
    (a, b, c, d), (A, B, C, D) = first, second
    upper = np.hstack([a, np.zeros((a.shape[0], A.shape[0]))])
    return np.vstack([upper, np.hstack([B @ c, A])]), np.vstack([b, B @ d]), np.hstack([D @ c, C]), D @ d


def in_series(M: Matrices, floor: float) -> tuple[Biquads, FloatArray] | None:
    """Return a stable scalar system of even order as sections in series and their parameters; None where it is neither.

    Poles and zeros meet in the order of their frequencies; poles less damped than the floor are lifted to just above.
    """
    A, B, C, D = M[0], _clean(M[1]), _clean(M[2]), M[3]
    poles, zeros = np.linalg.eigvals(A).astype(complex), invariant_zeros(A, B, C, D)
    if len(poles) % 2 or (poles.size and poles.real.max() >= 0) or zeros.size > poles.size:
        return None
    below, above = _pairs(poles), _pairs(zeros)
    if below is None or above is None:
        return None
    rows, scales = [], []
    for k, (d1, d0) in enumerate(below):
        w = np.sqrt(d0)
        zeta = d1 / (2 * w)
        num = np.array([0.0, 0.0, 1.0]) if k >= len(above) else above[k]
        num = num if len(num) == 3 else np.array([1.0, *num])
        v = np.sqrt(abs(num[2] / num[0])) if num[0] else (abs(num[2] / num[1]) if num[1] else w)
        v = float(v) if v > 0 else float(w)
        num = num / np.array([1.0, v, v * v])
        num = num / np.abs(num).max() * (1.0 if num[0] else w * w / (v * v))
        rows.append([np.log(w), np.log(max(zeta - (1 - FREE) * floor, 1.1 * FREE * floor)), *num])
        scales.append(v)
    element, theta = Biquads(np.array(scales), floor), np.array(rows).ravel()
    s = (1j * np.sqrt(np.array([d0 for _, d0 in below]))).astype(np.complex128)
    wanted = C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (s.size, *B.shape))) + D
    ratio = wanted[:, 0, 0] / element.response(theta, s)[:, 0, 0]
    return element, element.turned_down(theta, float(np.median(ratio.real)))


def _clean(M: FloatArray) -> FloatArray:
    """Return a matrix without entries that are rounding: scaled up, they would pass for couplings."""
    return np.where(np.abs(M) > ROUNDING * np.abs(M).max(initial=0.0), M, 0.0)


def _pairs(roots: ComplexArray) -> list[FloatArray] | None:
    """Return monic polynomials (of s, of 1) of pairs of roots, rising in size; a single real one left over comes last.

    That one is (0, 1, -root), a polynomial of degree one.
    """
    tiny = 1e-9 * np.abs(roots)
    complex_ = roots[roots.imag > tiny]
    real = np.sort_complex(roots[np.abs(roots.imag) <= tiny]).real
    if 2 * complex_.size + real.size != roots.size:
        return None
    real = real[np.argsort(np.abs(real), kind="stable")]
    out = [np.array([-2 * r.real, abs(r) ** 2]) for r in complex_]
    out += [np.array([-(a + b), a * b]) for a, b in zip(real[0::2], real[1::2], strict=False)]
    out.sort(key=lambda each: (abs(each[1]), each[0]))
    if real.size % 2:
        out.append(np.array([0.0, 1.0, -real[-1]]))
    return out
