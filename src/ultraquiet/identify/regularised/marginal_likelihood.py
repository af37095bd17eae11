"""Linear regression with a Gaussian prior whose hyper-parameters maximise the marginal likelihood.

y = Phi g + e, e ~ N(0, s I), g ~ N(0, s K(eta)), K block diagonal, one block for each signal's taps. With the QR factor
[Phi y] = Q [R r; 0 rho] everything after one pass over the data costs O(p^3), whatever the record's length:

    -2 log p(y) = n log s + log det A + (rho^2 + r' A^-1 r) / s + const,   A = I + R K R',

and s follows in closed form. Gradients cost O(p^2) more.

Reference: Chen, Ohlsson, Ljung 2012, doi:10.1016/j.automatica.2012.05.026; Chen, Ljung 2013,
doi:10.1016/j.automatica.2013.03.030.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray

BLOCK_ROWS = 2048  # samples compressed at a time
LOG_DECAY = (-9.0, 1.5)  # of the decay per sample: 1e-4 to 4.5
LOG_SCALE = (-60.0, 60.0)
TURN = (-6.0, 6.0)  # atanh of the correlation between neighbouring taps
FIRST_DECAYS = (0.005, 0.03, 0.15, 0.6)
FIRST_SCALES = (-6.0, -2.0, 2.0, 6.0)  # added to the logarithm of a prior that expects what least squares found
FIRST_TURN = 1.5
STEP = 1e-4  # of a hyper-parameter, all of which are logarithms
TAIL_RISE = 0.25  # of -2 log likelihood: half a standard deviation of the size of the tail
TAIL_DECAY = 2.0  # the tail's variance falls by so many e-folds over all taps
TAIL_SHARE = (-40.0, 0.0)  # logarithm of its variance beside the kernel's first
TAIL_HALVINGS = 12
# Share of the power of y that counts as error at least: without one, a record that follows exactly from its own past
# has a likelihood without bound, and the prior nothing to settle among the many taps that all explain it.
LEAST_ERROR = 1e-10
LOST = 1e10  # what a point without a likelihood costs


class PriorBlock(NamedTuple):
    """A kernel over m taps and its derivatives by the hyper-parameters."""

    K: FloatArray
    slopes: tuple[FloatArray, ...]


def tuned_correlated(eta: FloatArray, m: int) -> PriorBlock:
    """TC: K_kl = exp(scale) exp(-decay max(k, l)), k = 1, 2, ..."""
    k = np.arange(1, m + 1)
    latest = np.maximum.outer(k, k)
    decay = np.exp(eta[1])
    K = np.exp(eta[0] - decay * latest)
    return PriorBlock(K, (K, -decay * latest * K))


def diagonal_correlated(eta: FloatArray, m: int) -> PriorBlock:
    """DC: K_kl = exp(scale) exp(-decay (k + l) / 2) correlation^|k - l|."""
    k = np.arange(1, m + 1)
    total, apart = np.add.outer(k, k), np.abs(np.subtract.outer(k, k))
    decay, correlation = np.exp(eta[1]), np.tanh(eta[2])
    envelope = np.exp(eta[0] - decay * total / 2)
    power = correlation ** np.arange(m, dtype=np.float64)
    K = envelope * power[apart]
    turning = apart * (1 - correlation**2) * np.concatenate([[0.0], power[:-1]])[apart]
    return PriorBlock(K, (K, -decay * total / 2 * K, envelope * turning))


def stable_spline(eta: FloatArray, m: int) -> PriorBlock:
    """SS: K_kl = exp(scale) (exp(-decay (k + l + max)) / 2 - exp(-3 decay max) / 6)."""
    k = np.arange(1, m + 1)
    latest = np.maximum.outer(k, k)
    total = np.add.outer(k, k) + latest
    decay = np.exp(eta[1])
    first, second = np.exp(eta[0] - decay * total) / 2, np.exp(eta[0] - 3 * decay * latest) / 6
    K = first - second
    return PriorBlock(K, (K, -decay * (total * first - 3 * latest * second)))


KERNELS: dict[str, tuple[Callable[[FloatArray, int], PriorBlock], int]] = {
    "tc": (tuned_correlated, 2),
    "dc": (diagonal_correlated, 3),
    "ss": (stable_spline, 2),
}


@dataclass(frozen=True, eq=False)
class Posterior:
    """What the data and the prior say together.

    Attributes:
        mean: `(p,)` the estimate.
        covariance: `(p, p)` its posterior covariance.
        variance: of e.
        eta: hyper-parameters, block by block.
        converged: whether the hyper-parameters stand at a maximum.
        evaluations: of the marginal likelihood.
        freedom: how many numbers the prior leaves free to explain power by, trace(I - A^-2), and the hyper-parameters.
            White noise e becomes H e, H = I - A^-1, and e' e less what is left, |e - H e|^2, is e' (I - A^-2) e.
    """

    mean: FloatArray
    covariance: FloatArray
    variance: float
    eta: FloatArray
    converged: bool
    evaluations: int
    freedom: float


def compressed(signals: FloatArray, lags: Sequence[int], taps: Sequence[int], y: FloatArray, start: int) -> FloatArray:
    """Return the triangular factor of [1, Phi, y] without its first row: the constant is eliminated exactly.

    Args:
        signals: `(s, n)`.
        lags: the first column of signal i is the signal lag_i samples ago.
        taps: how many columns of it there are, each a sample further back.
        y: `(n,)`.
        start: first sample used; before it the past is not all on record (zero stands for what is not).
    """
    n, width = y.size, int(sum(taps)) + 2
    before = max((lag + m for lag, m in zip(lags, taps, strict=True)), default=0)
    padded = np.hstack([np.zeros((signals.shape[0], before)), signals])
    R = np.zeros((0, width))
    for first in range(start, n, BLOCK_ROWS):
        t = np.arange(first, min(n, first + BLOCK_ROWS)) + before
        columns = [np.ones((t.size, 1))]
        columns += [x[t[:, None] - lag - np.arange(m)] for x, lag, m in zip(padded, lags, taps, strict=True)]
        rows = np.hstack([*columns, y[t - before, None]])
        R = np.asarray(np.linalg.qr(np.vstack([R, rows]), mode="r"))
    out = np.zeros((width, width))
    out[: R.shape[0]] = R[:width]
    return out[1:, 1:]


def estimate(R: FloatArray, samples: int, taps: Sequence[int], kernel: str) -> Posterior:
    """Return the posterior under the hyper-parameters of the largest marginal likelihood.

    Args:
        R: factor from `compressed`.
        samples: rows it was made from, less one for the constant.
        taps: sizes of the blocks.
        kernel: "tc", "dc" or "ss".
    """
    from scipy.optimize import minimize

    problem = _Likelihood(R, samples, tuple(taps), kernel)
    optimum = minimize(
        problem.value_and_slope,
        problem.first(),
        jac=True,
        method="L-BFGS-B",
        bounds=problem.bounds(),
        options={"maxiter": 200, "ftol": 1e-10, "gtol": 1e-4},
    )
    return problem.posterior(np.asarray(optimum.x, dtype=np.float64), bool(optimum.success))


class _Likelihood:
    """-2 log marginal likelihood (less constants) as a function of all hyper-parameters."""

    def __init__(self, R: FloatArray, samples: int, taps: tuple[int, ...], kernel: str) -> None:
        self.R, self.r = R[:-1, :-1], R[:-1, -1]
        self.rho2 = float(R[-1, -1] ** 2 + LEAST_ERROR * np.sum(R[:, -1] ** 2))
        self.samples, self.taps = samples, taps
        self.make, self.each = KERNELS[kernel]
        self.evaluations = 0
        edges = np.concatenate([[0], np.cumsum(taps)])
        self.blocks = [slice(a, b) for a, b in pairwise(edges)]

    def bounds(self) -> list[tuple[float, float]]:
        """Return the box the search stays in."""
        return [LOG_SCALE, LOG_DECAY, TURN][: self.each] * len(self.taps)

    def first(self) -> FloatArray:
        """Return the best point of a coarse grid in which all blocks decay alike."""
        # A prior of the size at which the record's own power would come from the taps.
        power = float(self.r @ self.r + self.rho2)
        sizes = [max(float(np.sum(self.R[:, b] ** 2)), 1e-300) for b in self.blocks]
        base = [np.log(max(power, 1e-300) / size / max(power / self.samples, 1e-300)) for size in sizes]
        candidates = [
            np.concatenate([np.array([s + scale, np.log(decay), FIRST_TURN])[: self.each] for s in base])
            for decay in FIRST_DECAYS
            for scale in FIRST_SCALES
        ]
        return min(candidates, key=lambda eta: self.value_and_slope(eta)[0])

    def value_and_slope(self, eta: FloatArray) -> tuple[float, FloatArray]:
        """Return the function and its gradient."""
        return self._solved(eta)[:2]

    def _solved(self, eta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the function, its gradient, and the estimate under these hyper-parameters."""
        from scipy.linalg import solve_triangular

        self.evaluations += 1
        parts = self._kernels(eta)
        A = np.eye(self.R.shape[0])
        for b, part in zip(self.blocks, parts, strict=True):
            A += self.R[:, b] @ part.K @ self.R[:, b].T
        try:
            L = np.linalg.cholesky(A)
        except np.linalg.LinAlgError:
            return LOST, np.zeros(eta.size), np.full(self.R.shape[1], np.nan)
        W = solve_triangular(L, np.column_stack([self.R, self.r]), lower=True)
        total = self.rho2 + float(W[:, -1] @ W[:, -1])
        value = self.samples * np.log(total / self.samples) + 2.0 * float(np.sum(np.log(np.diag(L))))
        v = W[:, :-1].T @ W[:, -1]
        slope: list[float] = []
        mean = np.empty(v.size)
        for b, part in zip(self.blocks, parts, strict=True):
            G = W[:, b].T @ W[:, b]
            slope += [float(np.sum(G * dK) - self.samples / total * (v[b] @ dK @ v[b])) for dK in part.slopes]
            mean[b] = part.K @ v[b]
        return value, np.array(slope), mean

    def spread(self, eta: FloatArray) -> FloatArray:
        """Return what the uncertainty of the hyper-parameters adds to the covariance: J H^-1 J' by Laplace's method.

        H is half the curvature of the function, a direction it does not fix counting as one of unit deviation.
        """
        _, slope, mean = self._solved(eta)
        curvature, J = np.empty((eta.size, eta.size)), np.empty((mean.size, eta.size))
        for k in range(eta.size):
            moved = eta.copy()
            moved[k] += STEP
            _, there, elsewhere = self._solved(moved)
            curvature[k], J[:, k] = (there - slope) / STEP, (elsewhere - mean) / STEP
        values, vectors = np.linalg.eigh((curvature + curvature.T) / 4)
        turned = J @ vectors / np.sqrt(np.maximum(values, 1.0))
        return np.nan_to_num(turned @ turned.T)

    def posterior(self, eta: FloatArray, converged: bool) -> Posterior:
        """Return estimate and covariance in the square-root form, which keeps the covariance positive.

        The prior of the covariance has a slow tail beside the kernel: one decay for all taps is fixed by the first and
        largest ones, and would call the last ones surer than the record does.
        """
        from scipy.linalg import block_diag, solve_triangular

        from ultraquiet.linalg.balance import square_root

        _, _, mean = self._solved(eta)
        plain = [part.K for part in self._kernels(eta)]
        variance = self._total(plain)[1] / self.samples
        root = np.asarray(block_diag(*[square_root(K) for K in self._with_tail(plain)]))
        M = self.R @ root
        L = np.linalg.cholesky(np.eye(root.shape[1]) + M.T @ M)
        T = solve_triangular(L, root.T, lower=True)
        covariance = variance * T.T @ T + self.spread(eta)
        return Posterior(mean, covariance, variance, eta, converged, self.evaluations, self._freedom(plain) + eta.size)

    def _freedom(self, kernels: list[FloatArray]) -> float:
        A = np.eye(self.R.shape[0])
        for b, K in zip(self.blocks, kernels, strict=True):
            A += self.R[:, b] @ K @ self.R[:, b].T
        return len(A) - float(np.sum(np.linalg.inv(A) ** 2))

    def _with_tail(self, kernels: list[FloatArray]) -> list[FloatArray]:
        """Return the kernels with the largest slow tail that raises the function by no more than TAIL_RISE."""
        limit = self._total(kernels)[0] + TAIL_RISE
        slow = [
            K[0, 0] * tuned_correlated(np.array([0.0, np.log(TAIL_DECAY / m)]), m).K
            for K, m in zip(kernels, self.taps, strict=True)
        ]

        def tailed(log_share: float) -> list[FloatArray]:
            return [K + np.exp(log_share) * S for K, S in zip(kernels, slow, strict=True)]

        low, high = TAIL_SHARE
        for _ in range(TAIL_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._total(tailed(middle))[0] > limit else (middle, high)
        return tailed(low)

    def _total(self, kernels: list[FloatArray]) -> tuple[float, float]:
        """Return the function and the weighted sum of squares for given kernels."""
        from scipy.linalg import solve_triangular

        A = np.eye(self.R.shape[0])
        for b, K in zip(self.blocks, kernels, strict=True):
            A += self.R[:, b] @ K @ self.R[:, b].T
        L = np.linalg.cholesky(A)
        w = solve_triangular(L, self.r, lower=True)
        total = self.rho2 + float(w @ w)
        return self.samples * np.log(total / self.samples) + 2.0 * float(np.sum(np.log(np.diag(L)))), total

    def _kernels(self, eta: FloatArray) -> list[PriorBlock]:
        return [self.make(e, m) for e, m in zip(eta.reshape(len(self.taps), self.each), self.taps, strict=True)]
