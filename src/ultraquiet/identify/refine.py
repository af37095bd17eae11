"""Prediction-error refinement of a state-space model in modal coordinates: Gauss-Newton with analytic gradients.

The one-step predictor x+ = (A - K C) x + (B - K D) u + K y, y^ = C x + D u is an output-error model with inputs u and y.
In the modal coordinates of A - K C its derivatives are outputs of one bank of first-order filters, so the normal matrix
is read off one Gram matrix, and memory does not grow with the record. With K = 0 the inputs are u alone and the modes
those of A.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify import modal

# The search ends when a step would lower the weighted sum of squares by less than this many innovation variances: with
# hundreds of parameters far below the scatter that one of them has.
TOLERANCE = 0.05
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
TRUSTED = 1.0  # damping above which a small step is no sign of a minimum
EASED, STIFFENED = 0.1, 6.0
LONGEST = 1.0  # of a step in log(-log |p|): a decay time changes by at most a factor of e
FASTEST = 30.0  # of -log |p|: such a mode is gone within a sample
RIDGE = 1e-13  # on unit-diagonal normal matrices: keeps their factors finite, moves no kept digit


@dataclass(frozen=True, eq=False)
class Signals:
    """What drives the modes, one sample late `(J, n)`, what enters the outputs at once `(d, n)`, outputs `(ny, n)`."""

    drive: FloatArray
    tail: FloatArray
    outputs: FloatArray

    @classmethod
    def of(cls, inputs: FloatArray, u: FloatArray, y: FloatArray, feedthrough: bool, offset: bool) -> "Signals":
        """Collect them; a pulse before the first sample stands for the initial state, ones for a constant."""
        n = y.shape[1]
        pulse = np.zeros((1, n))
        pulse[0, 0] = 1.0
        late = np.hstack([np.zeros((len(inputs), 1)), inputs[:, :-1]])
        rest = ([u] if feedthrough else []) + ([np.ones((1, n))] if offset else [])
        tail = np.vstack(rest) if rest else np.zeros((0, n))
        return cls(np.vstack([late, pulse]), np.ascontiguousarray(tail), np.ascontiguousarray(y))


@dataclass(frozen=True, eq=False)
class Point:
    """Poles `(m,)`, b `(m, J)`, c `(ny, m)`, direct `(ny, d)` and the Gram matrix of `sensitivity_gram` there."""

    poles: ComplexArray
    b: ComplexArray
    c: ComplexArray
    direct: FloatArray
    G: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Sum of products of the errors, `(ny, ny)`."""
        ny = len(self.c)
        return self.G[-ny:, -ny:]


class Found(NamedTuple):
    """Where the search ended; `converged` says that no step is left that matters."""

    point: Point
    steps: int
    converged: bool


def search(
    start: Point,
    signals: Signals,
    weighted: bool,
    steps: int,
    admissible: Callable[[Point], bool] = lambda _: True,
) -> Found:
    """Lower log det of the error covariance (`weighted`) or the log of its trace, by Levenberg-Marquardt.

    Poles stay inside the unit circle by their parameters log(-log |p|) and arg p; a step that is not admissible is
    damped like one that raises the loss.
    """
    damping, done = DAMPING, 0
    point = evaluated(start, signals)
    loss = _loss(point, signals, weighted)
    while done < steps:
        equations = _Normal(_even(point), signals, weighted)
        while True:
            step, gain = equations.step(damping)
            if gain < TOLERANCE:
                return Found(point, done, damping < TRUSTED)
            other = evaluated(equations.moved(step), signals)
            lower = _loss(other, signals, weighted)
            if lower < loss and admissible(other):
                break
            damping *= STIFFENED
            if damping > MOST_DAMPING:
                return Found(point, done, False)
        point, loss, done = other, lower, done + 1
        damping = max(damping * EASED, LEAST_DAMPING)
    return Found(point, done, False)


def evaluated(at: Point, signals: Signals) -> Point:
    """Return the point with its own Gram matrix."""
    from ultraquiet.identify.state_kernels import sensitivity_gram

    G = sensitivity_gram(at.poles, at.b, at.c, at.direct, signals.drive, signals.tail, signals.outputs)
    return replace(at, G=G)


def _loss(at: Point, signals: Signals, weighted: bool) -> float:
    n, ny = signals.outputs.shape[1], len(at.c)
    if not np.all(np.isfinite(at.covariance)):
        return np.inf
    if weighted:
        sign, value = np.linalg.slogdet(at.covariance / n)
        return n * float(value) if sign > 0 else np.inf
    return n * ny * float(np.log(np.trace(at.covariance) / n))


def _even(at: Point) -> Point:
    """Return the point with b and c of equal size, which leaves the model and all products of c b s as they are."""
    size_b, size_c = np.linalg.norm(at.b, axis=1), np.linalg.norm(at.c, axis=0)
    good = (size_b > 0) & (size_c > 0)
    t = np.sqrt(np.where(good, size_c / np.where(good, size_b, 1.0), 1.0))
    scale = np.ones(len(at.G))
    high = 2 * (at.b.shape[1] + 1)
    for k in range(len(t)):
        scale[(k + 1) * high - 2 : (k + 1) * high] = t[k]
    return Point(at.poles, at.b * t[:, None], at.c / t, at.direct, at.G * scale[:, None] * scale)


class _Normal:
    """The normal equations at a point, outputs whitened; c and direct parts are the same for every whitened output."""

    def __init__(self, at: Point, signals: Signals, weighted: bool) -> None:
        self.at = at
        n, ny = signals.outputs.shape[1], len(at.c)
        if weighted:
            self.whiten = np.linalg.inv(np.linalg.cholesky(at.covariance / n))
        else:
            self.whiten = np.eye(ny) * np.sqrt(ny * n / np.trace(at.covariance))
        self.shape = (len(at.poles), at.b.shape[1] + 1, 2)
        self.size = int(np.prod(self.shape))
        self.turn = np.stack([modal.rotation(row) for row in self.whiten @ at.c])
        self._assemble()

    def _assemble(self) -> None:
        at, size, ny = self.at, self.size, len(self.at.c)
        inner = len(at.G) - ny
        G, Ge = at.G[:inner, :inner], at.G[:inner, inner:] @ self.whiten.T
        X = modal.state_map(at.b, 1, at.direct.shape[1])
        GX = G[:size] @ X.T
        bend = self._bend()
        blocks = G[:size, :size].reshape(*self.shape, *self.shape)
        N = np.zeros_like(blocks)
        for a, b, c, d in np.ndindex(2, 2, 2, 2):
            share = self.turn[:, :, a, c].T @ self.turn[:, :, b, d]
            N[:, :, a, :, :, b] += share[:, None, :, None] * blocks[:, :, c, :, :, d]
        cross = np.einsum("ikac,kjcq->ikjaq", self.turn, GX.reshape(*self.shape, -1)).reshape(ny, size, -1)
        right = np.einsum("ikac,kjci->kja", self.turn, Ge[:size].reshape(*self.shape, ny)).ravel()
        poles = self._pole_rows()
        N = N.reshape(size, size)
        for rows, M in zip(poles, bend, strict=True):
            N[rows] = M.T @ N[rows]
            N[:, rows] = N[:, rows] @ M
            cross[:, rows] = M.T @ cross[:, rows]
            right[rows] = M.T @ right[rows]
        real = at.poles.imag == 0.0
        self.kept_b = np.ones(self.shape, dtype=bool)
        self.kept_b[real, :, 1] = False
        self.kept_c = np.ones(X.shape[0], dtype=bool)
        self.kept_c[1 : 2 * len(real) : 2][real] = False
        kb, kc = self.kept_b.ravel(), self.kept_c
        self.N, self.right = N[np.ix_(kb, kb)], right[kb]
        self.cross = cross[:, kb][:, :, kc]
        self.inner, self.right_c = (X @ G @ X.T)[np.ix_(kc, kc)], (X @ Ge)[kc]

    def _pole_rows(self) -> list[slice]:
        high = 2 * self.shape[1]
        return [slice((k + 1) * high - 2, (k + 1) * high) for k in range(self.shape[0])]

    def _bend(self) -> list[FloatArray]:
        """Return d(Re p, Im p) by (log(-log |p|), arg p) for each pole."""
        p = self.at.poles
        slow, turn = p * np.log(np.abs(p)), 1j * p
        return [np.array([[s.real, t.real], [s.imag, t.imag]]) for s, t in zip(slow, turn, strict=True)]

    def step(self, damping: float) -> tuple[tuple[FloatArray, FloatArray], float]:
        """Return the damped step in (b and poles, c and direct), and the decrease of squares it promises."""
        from scipy.linalg import cho_factor, cho_solve, solve_triangular

        d = np.maximum(np.diag(self.inner), np.finfo(float).tiny) * (damping + RIDGE)
        L = np.linalg.cholesky(self.inner + np.diag(d))
        ny, size, width = self.cross.shape
        Y = solve_triangular(L, self.cross.reshape(ny * size, width).T, lower=True).reshape(width, ny, size)
        z = solve_triangular(L, self.right_c, lower=True)
        flat = Y.reshape(width * ny, size)
        e = np.maximum(np.diag(self.N), np.finfo(float).tiny) * (damping + RIDGE)
        schur = self.N + np.diag(e) - flat.T @ flat
        db = cho_solve(cho_factor(schur), self.right - flat.T @ z.ravel())
        dc = solve_triangular(L.T, z - Y @ db, lower=False)
        gain = float(db @ self.right + np.sum(dc * self.right_c))
        return (db, dc), gain

    def moved(self, step: tuple[FloatArray, FloatArray]) -> Point:
        """Return the point after a step, its Gram matrix not yet computed."""
        at, (db, dc) = self.at, step
        full = np.zeros(self.shape)
        full[self.kept_b] = db
        wide = np.zeros((len(self.kept_c), len(at.c)))
        wide[self.kept_c] = dc
        wide = np.linalg.solve(self.whiten, wide.T)
        m = 2 * len(at.poles)
        decay = -np.log(np.abs(at.poles)) * np.exp(np.clip(full[:, -1, 0], -LONGEST, LONGEST))
        p = np.exp(-np.minimum(decay, FASTEST) + 1j * (np.angle(at.poles) + full[:, -1, 1]))
        p = np.where(at.poles.imag == 0.0, p.real, p)
        b = at.b + full[:, :-1, 0] + 1j * full[:, :-1, 1]
        c = at.c + wide[:, 0:m:2] + 1j * wide[:, 1:m:2]
        below = p.imag < 0.0
        p, b, c = np.where(below, p.conj(), p), np.where(below[:, None], b.conj(), b), np.where(below, c.conj(), c)
        return Point(p, b, c, at.direct + wide[:, m:], at.G)
