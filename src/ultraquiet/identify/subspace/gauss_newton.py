"""Prediction-error refinement of a state-space model in second-order blocks: Gauss-Newton with analytic gradients.

The one-step predictor x+ = (A - K C) x + (B - K D) u + K y, y^ = C x + D u is an output-error model of u and y. In
blocks [[tau, sigma], [kappa sigma, tau]] of A - K C, two states each, its derivatives are outputs of one bank of
second-order filters: the normal matrix is read off one Gram matrix, and memory does not grow with the record. A complex
pair has kappa = -1, two real poles +1; it may pass through zero, where modal coordinates would break. With K = 0 the
inputs are u alone and the blocks those of A.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray

# The search ends when a step would lower the weighted sum of squares by less than this many innovation variances: with
# hundreds of parameters far below the scatter that one of them has.
TOLERANCE = 0.05
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
# It also ends when two steps running lowered them by less than this share of a unit per parameter: a minimum lies as
# many units below the truth as there are parameters, so what is left is lost in the scatter.
SETTLED = 2e-3
TRUSTED = 1.0  # damping above which a small step is no sign of a minimum
EASED, STIFFENED = 0.1, 6.0
LONGEST = 1.0  # of a step in log(-log |p|): a decay time changes by at most a factor of e
RIDGE = 1e-13  # of the diagonals of normal matrices and covariances: keeps their factors finite, moves no kept digit
# A pair whose turn in a sample is this share of its decay, or less, is as good as two real poles.
NEARLY_REAL = 1.0
NARROWEST = 1e-3  # smallest sigma, as a share of a block's decay
STABLE_RADIUS = 0.99999  # at 3.5 kHz a decay of 30 s: no block of two goes beyond, the model must simulate
# Modulus of a real pole that is an integrator's. At 3.5 kHz it decays within eight hours: no record tells it from one,
# and yet the model simulates and has a response at every frequency.
INTEGRATING = 1.0 - 1e-8
AT_THE_EDGE = 1e-3  # decay of a single pole over the whole record, in its logarithm, below which it moves no error
ROUNDED = 1e-9  # of a modulus, by which the matrices of a model may lose it


@dataclass(frozen=True, eq=False)
class Signals:
    """What drives the states, one sample late `(J, n)`, what enters the outputs at once `(d, n)`, outputs `(ny, n)`."""

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
class BlockModel:
    """Blocks tau, sigma, kappa `(m,)`, b `(m, 2, J)`, c `(ny, m, 2)`, direct `(ny, d)`, Gram matrix at this point.

    A block with sigma = 0 is a single real pole; its second state is not there.
    """

    tau: FloatArray
    sigma: FloatArray
    kappa: FloatArray
    b: FloatArray
    c: FloatArray
    direct: FloatArray
    G: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Sum of products of the errors, `(ny, ny)`."""
        return self.G[-len(self.c) :, -len(self.c) :]

    def inside(self) -> bool:
        """Return whether every pole is inside the circle as far as a model must be: a single one may integrate."""
        root = np.sqrt((self.kappa * self.sigma**2).astype(np.complex128))
        size = np.maximum(np.abs(self.tau + root), np.abs(self.tau - root))
        return bool(np.all(size <= np.where(self.sigma > 0, STABLE_RADIUS, INTEGRATING)))

    def at_the_edge(self, samples: int) -> NDArray[np.bool_]:
        """Return which blocks are single poles that do not decay over so many samples, `(m,)`."""
        return (self.sigma == 0) & (samples * (1.0 - np.abs(self.tau)) < AT_THE_EDGE)

    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, the input matrix of the driving signals and C."""
        m, ny = len(self.tau), len(self.c)
        A = np.zeros((2 * m, 2 * m))
        for k in range(m):
            s = self.sigma[k]
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[self.tau[k], s], [self.kappa[k] * s, self.tau[k]]]
        there = np.stack([np.ones(m, dtype=bool), self.sigma > 0], axis=1).ravel()
        return A[np.ix_(there, there)], self.b.reshape(2 * m, -1)[there], self.c.reshape(ny, 2 * m)[:, there]

    @classmethod
    def of(cls, A: FloatArray, B: FloatArray, C: FloatArray, direct: FloatArray) -> "BlockModel":
        """Return the blocks of a system whose A can be diagonalised; real poles are paired with their neighbours.

        Those nearer the circle than a block of two may be stay single.
        """
        values, vectors = (x.astype(np.complex128) for x in np.linalg.eig(A))
        into: ComplexArray = np.linalg.inv(vectors) @ B
        out: ComplexArray = C @ vectors
        blocks = [_pair(values[k], into[k], out[:, k]) for k in np.flatnonzero(values.imag > 0)]
        single = np.flatnonzero((values.imag == 0) & (np.abs(values) > STABLE_RADIUS)).tolist()
        real = [int(k) for k in np.argsort(values.real) if values[k].imag == 0 and k not in single]
        for i in range(0, len(real) - 1, 2):
            blocks.append(_two(values[real[i : i + 2]].real, into[real[i : i + 2]].real, out[:, real[i : i + 2]].real))
        for k in (real[-1:] if len(real) % 2 else []) + single:
            none = np.zeros_like(into[k].real)
            c = np.stack([out[:, k].real, np.zeros(len(C))], axis=1)
            blocks.append((float(values[k].real), 0.0, 0.0, np.stack([into[k].real, none]), c))
        tau, sigma, kappa, b, c = zip(*blocks, strict=True)
        none = np.zeros((0, 0))
        return cls(np.array(tau), np.array(sigma), np.array(kappa), np.stack(b), np.stack(c, axis=1), direct, none)


_Block = tuple[float, float, float, FloatArray, FloatArray]


def _pair(p: complex, b: ComplexArray, c: ComplexArray) -> _Block:
    """Return the block of y = 2 Re(c x), x+ = p x + b u."""
    return p.real, p.imag, -1.0, 2.0 * np.stack([b.real, -b.imag]), np.stack([c.real, c.imag], axis=1)


def _two(p: FloatArray, b: FloatArray, c: FloatArray) -> _Block:
    """Return the block of two real poles, in the coordinates sum and difference."""
    half = max(float(p[1] - p[0]) / 2.0, np.finfo(float).eps)
    joined, apart = np.stack([b[1] + b[0], b[1] - b[0]]), np.stack([c[:, 1] + c[:, 0], c[:, 1] - c[:, 0]], axis=1)
    return float(p.sum()) / 2.0, half, 1.0, joined, apart / 2.0


class SearchOutcome(NamedTuple):
    """Where the search ended, of what loss; `converged` says that no step is left that matters."""

    point: BlockModel
    steps: int
    converged: bool
    loss: float


def search(
    start: BlockModel,
    signals: Signals,
    weighted: bool,
    steps: int,
    admissible: Callable[[BlockModel], bool],
) -> SearchOutcome:
    """Lower log det of the error covariance (`weighted`) or the log of its trace, by Levenberg-Marquardt.

    A step that is not admissible is damped like one that raises the loss. Poles at the edge are held where that leaves
    no step: noise has drawn the minimum beyond the circle, and with them all else would stand still.
    """
    damping, done, slow = DAMPING, 0, 0
    point = evaluated(start, signals)
    loss = _loss(point, signals, weighted)
    held = np.zeros(len(start.tau), dtype=bool)
    while done < steps:
        equations = _Normal(_even(point), signals, weighted, held)
        while True:
            step, gain = equations.step(damping)
            if (gain < TOLERANCE and damping >= TRUSTED) or damping > MOST_DAMPING:
                edge = held | point.at_the_edge(signals.outputs.shape[1])
                if np.array_equal(edge, held):
                    return SearchOutcome(point, done, False, loss)
                held, damping = edge, DAMPING
                equations = _Normal(_even(point), signals, weighted, held)
                continue
            if gain < TOLERANCE:
                return SearchOutcome(point, done, True, loss)
            trial = equations.moved(step)
            if admissible(trial):
                other = evaluated(trial, signals)
                lower = _loss(other, signals, weighted)
                if lower < loss:
                    break
            damping *= STIFFENED
        slow = slow + 1 if loss - lower < SETTLED * equations.parameters else 0
        point, loss, done = other, lower, done + 1
        if slow == 2:
            return SearchOutcome(point, done, True, loss)
        damping = max(damping * EASED, LEAST_DAMPING)
    return SearchOutcome(point, done, False, loss)


def evaluated(at: BlockModel, signals: Signals) -> BlockModel:
    """Return the point with its own Gram matrix."""
    from ultraquiet.identify.subspace.kernels import sensitivity_gram

    blocks = map(np.ascontiguousarray, (at.tau, at.sigma, at.kappa, at.b, at.c, at.direct))  # compiled for one layout
    return replace(at, G=sensitivity_gram(*blocks, signals.drive, signals.tail, signals.outputs))


def _loss(at: BlockModel, signals: Signals, weighted: bool) -> float:
    n, ny = signals.outputs.shape[1], len(at.c)
    if not np.all(np.isfinite(at.covariance)):
        return np.inf
    if weighted:
        sign, value = np.linalg.slogdet(propped(at.covariance / n))
        return n * float(value) if sign > 0 else np.inf
    return n * ny * float(np.log(np.trace(at.covariance) / n))


def propped(covariance: FloatArray) -> FloatArray:
    """Return a covariance of errors that has a factor.

    Of a record without noise a model may explain one sum of the outputs to rounding, though it misses each of them: the
    errors are then shares of one another, and what is left of their determinant is rounding, of either sign.
    """
    return covariance + RIDGE * np.diag(np.diag(covariance))


def _even(at: BlockModel) -> BlockModel:
    """Return the point with b and c of equal size, which leaves the model as it is."""
    size_b, size_c = np.linalg.norm(at.b, axis=(1, 2)), np.linalg.norm(at.c, axis=(0, 2))
    good = (size_b > 0) & (size_c > 0)
    t = np.sqrt(np.where(good, size_c / np.where(good, size_b, 1.0), 1.0))
    high = 2 * at.b.shape[2] + 4
    scale = np.ones(len(at.G))
    for k in range(len(t)):
        scale[(k + 1) * high - 4 : (k + 1) * high] = t[k]  # only these rows have grown with b
    return replace(at, b=at.b * t[:, None, None], c=at.c / t[:, None], G=at.G * scale[:, None] * scale)


class _Normal:
    """The normal equations at a point, outputs whitened; c and direct parts are the same for every whitened output."""

    def __init__(self, at: BlockModel, signals: Signals, weighted: bool, held: NDArray[np.bool_] | None = None) -> None:
        self.at, self.held = at, np.zeros(len(at.tau), dtype=bool) if held is None else held
        n, ny = signals.outputs.shape[1], len(at.c)
        if weighted:
            self.whiten = np.linalg.inv(np.linalg.cholesky(propped(at.covariance / n)))
        else:
            self.whiten = np.eye(ny) * np.sqrt(ny * n / np.trace(at.covariance))
        c = np.einsum("ij,jka->ika", self.whiten, at.c)
        one, two = c[..., 0], c[..., 1]
        # from (b1, b2) to the rows (g, h): see `sensitivity_gram`
        self.turn = np.stack([np.stack([one, at.kappa * two], axis=-1), np.stack([two, one], axis=-1)], axis=2)
        self.c = c
        self._assemble()

    def _assemble(self) -> None:
        at, (ny, m, _) = self.at, self.c.shape
        J = at.b.shape[2]
        high, inner = 2 * J + 4, len(at.G) - ny
        rows = np.arange(m * high).reshape(m, high)
        of_b, of_p, rest = rows[:, :-4].ravel(), rows[:, -4:].ravel(), np.arange(m * high, inner)
        Ge = at.G[:inner, inner:] @ self.whiten.T
        X, used = _state_map(at), np.concatenate([of_b, rest])
        K = self._pole_map()
        bb = at.G[np.ix_(of_b, of_b)].reshape(m, J, 2, m, J, 2)
        N = np.zeros((m, 2, J, m, 2, J))
        for a, b, c, d in np.ndindex(2, 2, 2, 2):
            share = self.turn[:, :, a, c].T @ self.turn[:, :, b, d]
            N[:, a, :, :, b, :] += share[:, None, :, None] * bb[:, :, c, :, :, d]
        size = 2 * m * J
        bp = self._turned(at.G[np.ix_(of_b, of_p)], J)
        N_bp = np.einsum("ibr,ipr->bp", bp, K)
        pp = np.einsum("ipr,rs,iqs->pq", K, at.G[np.ix_(of_p, of_p)], K, optimize=True)
        cross_b = self._turned(at.G[np.ix_(of_b, used)] @ X.T, J)
        cross_p = K @ (at.G[np.ix_(of_p, used)] @ X.T)
        right_b = np.einsum("ikac,kjci->kaj", self.turn, Ge[of_b].reshape(m, J, 2, ny)).ravel()
        right_p = np.einsum("ipr,ri->p", K, Ge[of_p])
        kept = self._kept(m, J)
        whole = np.block([[N.reshape(size, size), N_bp], [N_bp.T, pp]])
        self.N, self.right = whole[np.ix_(kept, kept)], np.concatenate([right_b, right_p])[kept]
        self.kept, self.kept_c = kept, np.ones(len(X), dtype=bool)
        self.kept_c[1 : 2 * m : 2] = at.sigma > 0
        self.cross = np.concatenate([cross_b, cross_p], axis=1)[:, kept][:, :, self.kept_c]
        self.inner = (X @ at.G[np.ix_(used, used)] @ X.T)[np.ix_(self.kept_c, self.kept_c)]
        self.right_c = (X @ Ge[used])[self.kept_c]

    @property
    def parameters(self) -> int:
        """How many numbers the search moves."""
        return len(self.right) + self.right_c.size

    def _turned(self, rows: FloatArray, J: int) -> FloatArray:
        """Return, for each whitened output, the rows (g, h) of b's signals as rows of b's derivatives."""
        ny, m, _ = self.c.shape
        out = np.einsum("ikac,kjcq->ikajq", self.turn, rows.reshape(m, J, 2, -1))
        return out.reshape(ny, 2 * m * J, -1)

    def _kept(self, m: int, J: int) -> NDArray[np.bool_]:
        of_b, of_p = np.ones((m, 2, J), dtype=bool), np.ones((m, 2), dtype=bool)
        single = self.at.sigma == 0
        of_b[single, 1], of_p[single, 1] = False, False
        of_p[self.held, 0] = False
        return np.concatenate([of_b.ravel(), of_p.ravel()])

    def _pole_map(self) -> FloatArray:
        """Return, for each whitened output, the matrix from two parameters a block to the rows of its derivatives."""
        ny, m, _ = self.c.shape
        K = np.zeros((ny, m, 2, m, 4))
        for k in range(m):
            by = np.zeros((ny, 2, 4))
            by[:, 0, :2], by[:, 1, 2:] = self.c[:, k], self.c[:, k]
            K[:, k, :, k, :] = self._bend(k).T @ by
        return K.reshape(ny, 2 * m, 4 * m)

    def _turns(self, k: int) -> bool:
        """Return whether block k is a complex pair by far, which moves in logarithm of its decay and in angle."""
        at = self.at
        decay = 1.0 - np.hypot(at.tau[k], at.sigma[k])
        return bool(at.kappa[k] < 0 and np.sqrt(-at.kappa[k]) * at.sigma[k] > NEARLY_REAL * decay)

    def _bend(self, k: int) -> FloatArray:
        """Return d(tau, kappa) by the two parameters of block k."""
        at = self.at
        if at.sigma[k] == 0:
            return np.array([[at.tau[k] * np.log(max(abs(at.tau[k]), 1e-12)), 0.0], [0.0, 0.0]])
        if not self._turns(k):
            return np.array([[at.sigma[k], 0.0], [0.0, 1.0]])
        p = at.tau[k] + 1j * np.sqrt(-at.kappa[k]) * at.sigma[k]
        slow, turn = p * np.log(abs(p)), 1j * p
        down = -2.0 * p.imag / at.sigma[k] ** 2
        return np.array([[slow.real, turn.real], [down * slow.imag, down * turn.imag]])

    def step(self, damping: float) -> tuple[tuple[FloatArray, FloatArray], float]:
        """Return the damped step in (b and poles, c and direct), and the decrease of squares it promises."""
        from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

        least = np.finfo(float).tiny
        L = np.linalg.cholesky(self.inner + np.diag(np.maximum(np.diag(self.inner), least) * (damping + RIDGE)))
        ny, size, width = self.cross.shape
        Y = solve_triangular(L, self.cross.reshape(ny * size, width).T, lower=True).reshape(width, ny, size)
        z = solve_triangular(L, self.right_c, lower=True)
        flat = Y.reshape(width * ny, size)
        schur = self.N - flat.T @ flat + np.diag(np.maximum(np.diag(self.N), least) * (damping + RIDGE))
        try:
            db = cho_solve(cho_factor(schur), self.right - flat.T @ z.ravel())
        except LinAlgError:  # round-off left a direction without weight: more damping will do
            return (np.zeros(size), np.zeros_like(z)), np.inf
        dc = solve_triangular(L.T, z - Y @ db, lower=False)
        return (db, dc), float(db @ self.right + np.sum(dc * self.right_c))

    def moved(self, step: tuple[FloatArray, FloatArray]) -> BlockModel:
        """Return the point after a step, its Gram matrix not yet computed."""
        at, (db, dc) = self.at, step
        ny, m, _ = at.c.shape
        J = at.b.shape[2]
        full = np.zeros(len(self.kept))
        full[self.kept] = db
        wide = np.zeros((len(self.kept_c), ny))
        wide[self.kept_c] = dc
        wide = np.linalg.solve(self.whiten, wide.T)
        poles = full[2 * m * J :].reshape(m, 2)
        blocks = np.array([self._block(k, *poles[k]) for k in range(m)])
        b, c = at.b + full[: 2 * m * J].reshape(m, 2, J), at.c + wide[:, : 2 * m].reshape(ny, m, 2)
        ratio = np.where(at.sigma > 0, at.sigma / np.where(at.sigma > 0, blocks[:, 1], 1.0), 1.0)
        b, c = b.copy(), c.copy()
        b[:, 1] *= ratio[:, None]
        c[:, :, 1] /= ratio
        return BlockModel(blocks[:, 0], blocks[:, 1], blocks[:, 2], b, c, at.direct + wide[:, 2 * m :], at.G)

    def _block(self, k: int, first: float, second: float) -> tuple[float, float, float]:
        """Return tau, sigma and kappa of block k after a step, sigma chosen so that kappa is -1 or 1 where it can."""
        at = self.at
        if at.sigma[k] == 0 or self._turns(k):
            p = at.tau[k] + 1j * np.sqrt(max(-at.kappa[k], 0.0)) * at.sigma[k]
            decay = -np.log(max(abs(p), 1e-12)) * np.exp(np.clip(first, -LONGEST, LONGEST))
            p = np.exp(-decay + 1j * (np.angle(p) + second))
            tau, square = p.real, -(p.imag**2)
            if at.sigma[k] == 0:
                return tau, 0.0, 0.0
        else:
            tau, square = at.tau[k] + at.sigma[k] * first, (at.kappa[k] + second) * at.sigma[k] ** 2
        least = NARROWEST * max(1.0 - abs(tau), NARROWEST)
        sigma = max(np.sqrt(abs(square)), least)
        return tau, sigma, square / sigma**2


def _state_map(at: BlockModel) -> FloatArray:
    """Return the matrix from rows (g, h) of all inputs, and the direct rows, to states x and the direct rows."""
    m, _, J = at.b.shape
    d = at.direct.shape[1]
    X = np.zeros((2 * m + d, 2 * m * J + d))
    for k in range(m):
        rows = slice(2 * k * J, 2 * (k + 1) * J)
        one, two = at.b[k]
        X[2 * k, rows] = np.stack([one, two], axis=1).ravel()
        X[2 * k + 1, rows] = np.stack([two, at.kappa[k] * one], axis=1).ravel()
    X[2 * m :, 2 * m * J :] = np.eye(d)
    return X
