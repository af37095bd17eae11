"""A state-space model from data of a closed loop: subspace of the one-step predictor, which looks at the past alone."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.identify.record_checks import usable
from ultraquiet.identify.result import Result
from ultraquiet.identify.searched_order import Auto, SearchedOrder
from ultraquiet.identify.subspace import evidence, fit, missing_modes, other_starts
from ultraquiet.identify.subspace.method import Subspace
from ultraquiet.linalg.polynomial_roots import mirrored_inside
from ultraquiet.values import Record

LONGEST = 100  # block rows of the past tried when no horizon is given
SAMPLES_PER_COLUMN = 4  # of the record for every regressor of the longest past
RIDGE = 1e-11  # of the Gram matrix' mean diagonal, as in `hankel`, added where a filter's past repeats itself
HIGHEST = 200  # states among which an order is chosen


@register("identify", "predictor-subspace")
@dataclass(frozen=True)
class PredictorSubspace(SearchedOrder):
    """x+ = A x + B u + K e, y = C x + D u + e from records in open or closed loop: the optimised predictor form.

    A long autoregression with inputs y(t) = sum_{j=1}^{p} Theta_j [u; y](t - j) + e(t) is consistent whatever makes the
    inputs, for the past holds nothing of e(t). Its coefficients are the pulse response of the predictor (A - K C), so
    the matrix of Theta_{i+j} times the past is observability times state; a singular value decomposition gives the
    state, two regressions on it the model. All of it is read off one Gram matrix of the record's shifts.

    Args:
        order: number of states; "auto" or None takes the order of least BIC of the regression on the states.
        horizon: samples of past p; it must span the predictor's memory, which is shorter than the plant's. None takes
            that of least AIC of the autoregression.
        feedthrough: whether D is estimated. In a closed loop this asks for a controller that does not answer within the
            same sample; otherwise D must be zero.
        offset: whether a constant at each output is fitted.
        refine: whether a search lowers the one-step error of all parameters together.
        weighted: as in `Subspace`.
        stable: whether the plant is known to be stable; False admits a plant that only its loop holds.
        max_iterations: steps of the search.

    Returns of `identify`: `Result` whose model is an `InnovationForm`; evidence and loss are of the one-step error.

    Reference: Chiuso, Automatica 43 (2007) 1034, doi:10.1016/j.automatica.2006.12.009; Jansson, SSARX, IFAC 2003,
    doi:10.1016/S1474-6670(17)34969-8.

    >>> import numpy as np, ultraquiet as uq
    >>> plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((1, 4000))
    >>> y = plant.simulate(u) + 0.1 * rng.standard_normal((1, 4000))
    >>> result = uq.identify.PredictorSubspace(order=2).identify(uq.Record(u, y, rate_hz=100.0))
    >>> result.model.poles().round(2)
    array([0.9+0.3j, 0.9-0.3j])
    """

    name: ClassVar[str] = "predictor-subspace"

    order: int | Auto | None = None
    horizon: int | None = None
    feedthrough: bool = False
    offset: bool = True
    refine: bool = True
    weighted: bool = True
    stable: bool = True
    max_iterations: int = 100

    def __post_init__(self) -> None:
        self.settle_order(500)
        if self.horizon is not None:
            whole("PredictorSubspace", "horizon", self.horizon, 1, 1000)
        whole("PredictorSubspace", "max_iterations", self.max_iterations, 1)

    def identify(self, record: Record) -> Result:
        """Return the model of all channels of the record.

        Raises:
            InputError: too few samples for order and horizon, a constant input or output, inputs that are copies of
                each other.
        """
        longest = self._longest(record)
        # Every state brings a column of B and a row of C at least.
        wires = len(record.actuators) + len(record.sensors)
        usable("PredictorSubspace", record, (self.given_order or 2) * wires // len(record.sensors), longest)
        evidence.independent("PredictorSubspace", record)
        data = fit.Scaled.of(record)
        regression = Regression.of(data, longest, self.feedthrough)
        past = self.horizon or regression.memory(1 + (self.given_order or 1) // len(record.sensors))
        states = regression.states(past)
        start = self._start(states)
        found = fit.Fitted(start, 0, True)
        if self.refine:
            options = fit.Options(self.feedthrough, self.offset, self.weighted, self.max_iterations)
            own = fit.refined_prediction(start, data, options, self.stable)
            others = other_starts.from_simulation(self._simulating(), record, data, options) if self.stable else []
            found = other_starts.best([own, *others], data, self.weighted)
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        details = {"horizon": past, "order": len(found.system.A), "singular_values": states.values}
        search = evidence.SearchSummary(found.steps, found.converged, True, self.refine, self.weighted)
        result = evidence.judged(found.system, record, data, search, provenance, details)
        return missing_modes.told(result, found.system, data, record.rate_hz, predicts=True)

    def _start(self, states: "States") -> fit.System:
        start = states.model(min(self.given_order or states.order(), len(states.values)))
        if self.stable:
            start = _mirrored_inside(start)
        return replace(start, K=start.K if start.predicts() else np.zeros_like(start.K))

    def _simulating(self) -> Subspace:
        """Return the method that fits the plant by its simulated error, on the same terms."""
        return Subspace(
            order=self.order,
            feedthrough=self.feedthrough,
            offset=self.offset,
            refine=True,
            weighted=self.weighted,
            max_iterations=self.max_iterations,
        )

    def _longest(self, record: Record) -> int:
        width = len(record.actuators) + len(record.sensors)
        most = record.samples // (SAMPLES_PER_COLUMN * width) - 1
        least = self.horizon or 1 + (self.given_order or 1) // len(record.sensors)
        if most < least:
            needed = (least + 1) * SAMPLES_PER_COLUMN * width
            raise InputError(
                f"PredictorSubspace: a past of {least} samples needs at least {needed} samples, the record has "
                f"{record.samples}; record longer or lower order or horizon."
            )
        return self.horizon or min(most, max(LONGEST, least))


@dataclass(frozen=True, eq=False)
class Regression:
    """Gram matrix of z(t), z(t-1), ..., z(t-p), z = [u; y], the newest first."""

    G: FloatArray
    nu: int
    ny: int
    samples: int
    feedthrough: bool

    @classmethod
    def of(cls, data: fit.Scaled, longest: int, feedthrough: bool) -> "Regression":
        """Sum the products of a record with a past of `longest` samples."""
        from ultraquiet.identify.subspace.kernels import hankel_gram

        z = np.ascontiguousarray(np.vstack([data.centred_u, data.y]))
        width = len(z)
        newest = np.arange((longest + 1) * width).reshape(longest + 1, width)[::-1].ravel()
        G = hankel_gram(z, longest + 1)[np.ix_(newest, newest)]
        G[np.diag_indices_from(G)] += RIDGE * np.trace(G) / len(G)
        return cls(G, len(data.u), len(data.y), data.samples - longest, feedthrough)

    def memory(self, least: int) -> int:
        """Return the past of least AIC, not below `least`: n log det of the errors + 2 (regressors) (outputs)."""
        width, ny = self.nu + self.ny, self.ny
        known = np.arange(self.nu if self.feedthrough else 0)
        order = np.concatenate([known, np.arange(width, len(self.G)), np.arange(self.nu, width)])
        rows = np.linalg.cholesky(self.G[np.ix_(order, order)])[-ny:]
        longest = len(self.G) // width - 1
        left = rows @ rows.T
        left -= rows[:, : len(known)] @ rows[:, : len(known)].T
        costs = np.full(longest + 1, np.inf)
        for p in range(1, longest + 1):
            used = rows[:, len(known) + (p - 1) * width : len(known) + p * width]
            left = left - used @ used.T
            sign, value = np.linalg.slogdet(left / self.samples)
            if sign > 0 and p >= min(least, longest):
                costs[p] = self.samples * value + 2.0 * p * width * ny
        return int(np.argmin(costs))

    def states(self, past: int) -> "States":
        """Return the state directions that a past of so many samples gives."""
        width, nu, ny = self.nu + self.ny, self.nu, self.ny
        G = self.G[: (past + 1) * width, : (past + 1) * width]
        before = np.arange(width, len(G))
        known = np.concatenate([np.arange(nu if self.feedthrough else 0), before])
        theta = np.linalg.solve(G[np.ix_(known, known)], G[known, nu:width]).T[:, len(known) - len(before) :]
        M = np.zeros((past * ny, past * width))
        for i in range(past):
            M[i * ny : (i + 1) * ny, : (past - i) * width] = theta[:, i * width :]
        root = np.linalg.cholesky(G[np.ix_(before, before)])
        left, values, _ = np.linalg.svd(M @ root, full_matrices=False)
        kept = min(len(values), past * ny, HIGHEST)
        T = (left[:, :kept].T @ M) / np.sqrt(np.maximum(values[:kept], np.finfo(float).tiny))[:, None]
        return States(G, T, values[:kept], nu, ny, self.samples, self.feedthrough)


class States(NamedTuple):
    """States as rows of `T` over the past z(t-1), ..., z(t-p), by falling singular value."""

    G: FloatArray
    T: FloatArray
    values: FloatArray
    nu: int
    ny: int
    samples: int
    feedthrough: bool

    def order(self) -> int:
        """Return the order of least BIC: n log det of the errors of y on the states + log n (free parameters)."""
        width = self.nu + self.ny
        known = np.arange(self.nu if self.feedthrough else 0)
        n, direct = len(self.T), len(known)
        rows = np.zeros((direct + n + self.ny, len(self.G)))
        rows[np.arange(direct), known] = 1.0
        rows[direct : direct + n, width:] = self.T
        rows[direct + n :, self.nu : width] = np.eye(self.ny)
        N = rows @ self.G @ rows.T
        N[np.diag_indices_from(N)] += RIDGE * np.diag(N)
        last = np.linalg.cholesky(N)[-self.ny :]
        left = last @ last.T - last[:, :direct] @ last[:, :direct].T
        costs = []
        for k in range(n):
            left = left - np.outer(last[:, direct + k], last[:, direct + k])
            free = (k + 1) * (2 * self.ny + self.nu)
            costs.append(self.samples * np.linalg.slogdet(left / self.samples)[1] + np.log(self.samples) * free)
        return int(np.argmin(costs)) + 1

    def model(self, order: int) -> fit.System:
        """Return the model whose state is the first `order` directions: y, then the next state, regressed on it."""
        width, nu, ny = self.nu + self.ny, self.nu, self.ny
        size = len(self.G)
        x, ahead = np.zeros((order, size)), np.zeros((order, size))
        x[:, width:] = self.T[:order]
        ahead[:, : size - width] = self.T[:order]
        now = np.eye(width, size)
        u, y = now[:nu], now[nu:]
        known = np.vstack([x, u]) if self.feedthrough else x
        first = self._regressed(y, known)
        C, D = first[:, :order], first[:, order:] if self.feedthrough else np.zeros((ny, nu))
        e = y - first @ known
        second = self._regressed(ahead, np.vstack([x, u, e]))
        A, B, K = second[:, :order], second[:, order : order + nu], second[:, order + nu :]
        return fit.System(A, B, C, D, K, np.zeros(order), np.zeros(ny))

    def _regressed(self, target: FloatArray, on: FloatArray) -> FloatArray:
        N = on @ self.G @ on.T
        scale = 1.0 / np.sqrt(np.diag(N))
        scaled = np.linalg.lstsq(N * scale[:, None] * scale, (on @ self.G @ target.T) * scale[:, None], rcond=1e-12)[0]
        return (scaled * scale[:, None]).T


def _mirrored_inside(start: fit.System) -> fit.System:
    """Return the system with its poles inside the circle, all else as it was."""
    values, vectors = np.linalg.eig(start.A)
    if np.abs(values).max() <= fit.STABLE_RADIUS:
        return start
    inside = mirrored_inside(values.astype(np.complex128), fit.STABLE_RADIUS)
    return replace(start, A=(vectors @ np.diag(inside) @ np.linalg.inv(vectors)).real)
