"""Least squares in the logarithms of positive parameters: the step of least size, and what the data cannot tell."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray

Residual = Callable[[FloatArray], FloatArray]
# Central differences of this size in a logarithm leave 1e-10 of relative error.
STEP = 1e-5
# Directions in which the residual moves less than this share of the most telling one are told by rounding alone.
RANK = 1e-7
# A direction whose logarithm has a deviation above one (a factor e) is not told either: the valley has no bottom there.
LEAST = 1.0
# A search has ended when the step would lower the sum of squares (in units of its variance) by less than this.
TOLERANCE = 1e-3
# Largest change of a logarithm in one step.
LARGEST_STEP = 1.5
FIRST_DAMPING, LESS, MORE, MOST_DAMPING = 1e-3, 0.1, 4.0, 1e8
AT_BOUND = 1e-9


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended: logarithms, residual and its Jacobian there, accepted steps, whether it is a minimum."""

    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    iterations: int
    converged: bool

    @property
    def loss(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


def jacobian(residual: Residual, x: FloatArray) -> FloatArray:
    """Return d residual / d x by central differences, `(m, p)`."""
    columns = []
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = STEP
        columns.append((residual(x + step) - residual(x - step)) / (2 * STEP))
    return np.stack(columns, axis=1)


def search(
    residual: Residual,
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    iterations: int,
    slopes: Callable[[FloatArray], FloatArray] | None = None,
) -> Minimum:
    """Minimise |residual(x)|^2 within bounds by Levenberg and Marquardt's steps in the singular directions.

    Parameters that the data do not tell stay where they began. A parameter that would leave its bounds is held there
    for the step.

    Args:
        residual: of the parameters `(p,)`, each divided by its standard deviation.
        start: `(p,)`.
        low: `(p,)` bounds.
        high: likewise.
        iterations: accepted steps at most.
        slopes: the Jacobian `(m, p)`; by central differences when absent.
    """
    slopes = slopes or (lambda x: jacobian(residual, x))
    x = np.clip(start, low, high)
    r, damping, done = residual(x), FIRST_DAMPING, 0
    J = slopes(x)
    while done < iterations:
        scale = float(r @ r) / max(1, r.size - x.size)
        step, gain = _step(J, r, x, low, high, damping, LEAST * np.sqrt(scale))
        if gain <= TOLERANCE * scale:
            return Minimum(x, r, J, done, True)
        step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), LARGEST_STEP))
        tried = np.clip(x + step, low, high)
        new = residual(tried)
        if np.all(np.isfinite(new)) and new @ new < r @ r:
            x, r, damping, done = tried, new, damping * LESS, done + 1
            J = slopes(x)
        elif damping > MOST_DAMPING:
            return Minimum(x, r, J, done, bool(gain <= np.sqrt(TOLERANCE) * scale))
        else:
            damping *= MORE
    return Minimum(x, r, J, done, False)


def _step(
    J: FloatArray, r: FloatArray, x: FloatArray, low: FloatArray, high: FloatArray, damping: float, least: float
) -> tuple[FloatArray, float]:
    """Return the damped step and what an undamped one would gain in directions that the data tell.

    Parameters at a bound are held there where they want to leave.
    """
    gradient = J.T @ r
    free = ~(((x <= low + AT_BOUND) & (gradient > 0)) | ((x >= high - AT_BOUND) & (gradient < 0)))
    step = np.zeros(x.size)
    if not free.any():
        return step, 0.0
    # Logarithms need no scaling; scaled, the least telling parameters would move the most.
    U, s, Vt = np.linalg.svd(J[:, free], full_matrices=False)
    determined = s > RANK * max(s[0], np.finfo(float).tiny)
    along = (U.T @ r)[determined]
    s, Vt = s[determined], Vt[determined]
    step[free] = -Vt.T @ (s * along / (s**2 + damping * s[0] ** 2)) if s.size else 0.0
    return step, float(np.sum(along[s > least] ** 2))


@dataclass(frozen=True)
class Combination:
    """A product of powers that the data tell, prod symbol^power, and the relative standard deviation of its value."""

    powers: dict[str, float]
    relative_deviation: float

    def __str__(self) -> str:
        """Return it as a formula."""
        return " ".join(k if p == 1 else f"{k}^{p:.3g}" for k, p in self.powers.items())


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the Jacobian says the data tell.

    Attributes:
        covariance: `(p, p)` of the logarithms, along directions that move the residual at all.
        silent: `(p, p)` projector on the directions that leave the residual as it is.
        unbounded: `(p,)` True where a parameter moves along those, or is uncertain by more than a factor e.
        combinations: as many as there are directions told within that factor.
    """

    covariance: FloatArray
    silent: FloatArray
    unbounded: np.ndarray
    combinations: tuple[Combination, ...]


# Least share of a parameter in an untold direction that counts, and least power that is printed.
SHARE = 1e-3


def identifiability(J: FloatArray, names: tuple[str, ...], inflation: float = 1.0) -> Identifiability:
    """Return covariance and told combinations for a Jacobian in units of the noise, `(m, p)`.

    Args:
        J: `(m, p)`.
        names: of the parameters.
        inflation: of the variance, where the residual is larger than its noise.
    """
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    determined = s > RANK * s[0]
    rows = Vt[determined]
    silent = np.eye(J.shape[1]) - rows.T @ rows
    covariance = inflation * (rows.T / s[determined] ** 2) @ rows
    unbounded = np.sqrt(np.maximum(np.diag(silent), 0.0)) > SHARE
    unbounded |= np.sqrt(np.diag(covariance)) > LEAST
    rows = Vt[determined & (s > np.sqrt(inflation) / LEAST)]
    combinations = []
    for row in _reduced(rows):
        powers = {n: float(np.round(a, 6)) for n, a in zip(names, row, strict=True) if abs(a) > SHARE}
        combinations.append(Combination(powers, float(np.sqrt(row @ covariance @ row))))
    return Identifiability(covariance, silent, unbounded, tuple(combinations))


def _reduced(rows: FloatArray) -> FloatArray:
    """Return the reduced row echelon form, pivots taken where they are largest."""
    R = rows.copy()
    for k in range(len(R)):
        i, j = np.unravel_index(np.abs(R[k:]).argmax(), R[k:].shape)
        R[[k, k + int(i)]] = R[[k + int(i), k]]
        R[k] /= R[k, j]
        others = np.arange(len(R)) != k
        R[others] -= np.outer(R[others, j], R[k])
    return R


def chi_squared(statistic: float, freedom: int) -> float:
    """Return the p-value of a sum of squares."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, statistic))
