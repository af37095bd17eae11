"""States of the one-step predictor, read off the Gram matrix of a record's past: what a long autoregression holds."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.subspace import fit

LONGEST = 100  # block rows of the past tried when no horizon is given
SAMPLES_PER_COLUMN = 4  # of the record for every regressor of the longest past
RIDGE = 1e-11  # of the Gram matrix' mean diagonal, as in `hankel`, added where a filter's past repeats itself
HIGHEST = 200  # states among which an order is chosen


@dataclass(frozen=True, eq=False)
class PastRegression:
    """Gram matrix of z(t), z(t-1), ..., z(t-p), z = [u; y], the newest first."""

    G: FloatArray
    nu: int
    ny: int
    samples: int
    feedthrough: bool

    @classmethod
    def of(cls, data: fit.Scaled, longest: int, feedthrough: bool) -> "PastRegression":
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

    def states(self, past: int) -> "PredictorStates":
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
        return PredictorStates(G, T, values[:kept], nu, ny, self.samples, self.feedthrough)


class PredictorStates(NamedTuple):
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
