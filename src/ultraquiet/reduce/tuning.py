"""A small controller's parameters moved downhill on the cost of the loop it closes."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Array, Matrices
from ultraquiet.reduce.grid import Grid

MEMORY = 40  # pairs of steps that stand for the curvature
WALL = 1e3  # cost, in units of the full controller's, of a controller that would lose the loop


class LawSizes(NamedTuple):
    """Sizes of a controller whose A has 2x2 blocks; an odd state is paired with one that nothing drives or reads."""

    states: int
    nu: int
    ny: int
    copies: int

    @property
    def blocks(self) -> int:
        """Number of 2x2 blocks."""
        return (self.states + 1) // 2

    def unpack(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Return blocks of A `(k, 2, 2)`, B, C and D."""
        k, n = self.blocks, 2 * self.blocks
        a, b, c = 4 * k, 4 * k + n * self.ny, 4 * k + n * (self.ny + self.nu)
        return (
            x[:a].reshape(k, 2, 2),
            x[a:b].reshape(n, self.ny),
            x[b:c].reshape(self.nu, n),
            x[c:].reshape(self.nu, self.ny),
        )


class Response(NamedTuple):
    """K, (zI - A)^-1 B and C (zI - A)^-1 on the grid."""

    K: Array
    RB: Array
    CR: Array


def packed(M: Matrices, shape: LawSizes, discrete: bool) -> FloatArray | None:
    """Return the parameters of a controller in modal form; None when its modes cannot be told apart."""
    form = balance.modal(*M[:3])
    if form.blocks and max(form.blocks) > 2:
        return None
    edges = np.cumsum((0, *form.blocks))
    pairs = [i for low, high in pairwise(edges) if high - low == 2 for i in (low, low + 1)]
    order = pairs + [low for low, high in pairwise(edges) if high - low == 1]
    n, k = shape.states, shape.blocks
    A = np.eye(2 * k) * (0.0 if discrete else -1.0)
    A[:n, :n] = form.A[np.ix_(order, order)]
    B, C = np.zeros((2 * k, shape.ny)), np.zeros((shape.nu, 2 * k))
    B[:n], C[:, :n] = form.B[order], form.C[:, order]
    blocks = np.array([A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(k)])
    return np.concatenate([blocks.ravel(), B.ravel(), C.ravel(), np.ravel(M[3])])


def matrices(x: FloatArray, shape: LawSizes) -> Matrices:
    """Return A, B, C, D of parameters."""
    blocks, B, C, D = shape.unpack(x)
    A = np.zeros((2 * shape.blocks,) * 2)
    for i, block in enumerate(blocks):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    n = shape.states
    return A[:n, :n], B[:n].copy(), C[:, :n].copy(), D.copy()


class Descent:
    """Costs of a controller's parameters with their gradients, and the searches that lower them."""

    def __init__(self, grid: Grid, shape: LawSizes, norm: str, discrete: bool) -> None:
        self._grid, self._shape, self._norm, self._discrete = grid, shape, norm, discrete
        left, right = grid.influence(grid.K), grid.sensitivity(grid.K)
        self._left, self._right = _adjoint(left) @ left, right @ _adjoint(right)
        self._scale = grid.norm(grid.K, "mean-square") ** 2
        self._before = grid.norm(grid.K, norm)

    def towards_full(self, x: FloatArray, steps: int) -> FloatArray:
        """Lower the error that counts to first order, ||P12 (I - K P22)^-1 (Kr - K) (I - P22 K)^-1 P21||."""
        share = self._grid.share[:, None, None]

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            now = self.response(x)
            error = now.K - self._grid.K
            slope = share * (self._left @ error @ self._right)
            value = float(np.sum((np.conj(error) * slope).real))
            return value / self._scale, self._gradient(2 / self._scale * slope, now)

        return _lowered(cost, x, steps)

    def on_loop(self, x: FloatArray, steps: int, power: int) -> FloatArray:
        """Lower the norm of the loop itself: its mean square, or the peak by its smooth 2 `power`-norm."""
        unstable_before = self._unstable(x, self.response(x).K)

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            now = self.response(x)
            if abs(self._unstable(x, now.K) - unstable_before) > 0.5:
                return WALL, np.zeros_like(x)
            seen = self._grid.sensitivity(now.K)
            F = self._grid.P11 + self._grid.P12 @ now.K @ seen
            value, slope = self._smooth(F, power)
            return value, self._gradient(_adjoint(self._grid.influence(now.K)) @ slope @ _adjoint(seen), now)

        return _lowered(cost, x, steps)

    def cost(self, x: FloatArray) -> float:
        """Return the loop's norm on the grid over that with the full controller."""
        return self._grid.norm(self.response(x).K, self._norm) / self._before

    def response(self, x: FloatArray) -> Response:
        """Return the responses that the parameters give."""
        blocks, B, C, D = self._shape.unpack(x)
        z = self._grid.points[:, None]
        a, b, c, d = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 0], blocks[:, 1, 1]
        R = np.array([[z - d, b + 0 * z], [c + 0 * z, z - a]]) / ((z - a) * (z - d) - b * c)
        R: Array = np.moveaxis(R, (0, 1), (2, 3))
        count, k, n = len(z), self._shape.blocks, 2 * self._shape.blocks
        RB = (R @ B.reshape(k, 2, -1)).reshape(count, n, -1)
        CR = np.einsum("ubi,kbij->kubj", C.reshape(-1, k, 2), R).reshape(count, -1, n)
        K = C @ RB + D
        return Response(K * np.eye(self._shape.copies) if self._shape.copies > 1 else K, RB, CR)

    def _gradient(self, slope: Array, at: Response) -> FloatArray:
        """Return the gradient over the parameters of a cost whose gradient over the response K is `slope`."""
        if self._shape.copies > 1:
            slope = np.trace(slope, axis1=1, axis2=2)[:, None, None]
        k, count = self._shape.blocks, len(slope)
        CG = _adjoint(at.CR) @ slope
        A = np.einsum("kbiy,kbjy->bij", CG.reshape(count, k, 2, -1), np.conj(at.RB.reshape(count, k, 2, -1))).real
        C = (slope @ _adjoint(at.RB)).sum(axis=0).real
        # the direct term stands still where moving it would make a mean square infinite
        D = slope.sum(axis=0).real * (self._discrete or self._norm == "peak")
        return np.concatenate([A.ravel(), CG.sum(axis=0).real.ravel(), C.ravel(), D.ravel()])

    def _smooth(self, F: Array, power: int) -> tuple[float, Array]:
        share = self._grid.share[:, None, None]
        if self._norm == "mean-square":
            return float(np.sum(share * np.abs(F) ** 2)) / self._scale, 2 / self._scale * share * F
        size = np.linalg.norm(F, 2, axis=(1, 2)).max()
        square = _adjoint(F) @ F / size**2
        lower = np.linalg.matrix_power(square, power - 1)
        total = float(np.sum(share[:, 0, 0] * np.einsum("kij,kji->k", lower, square).real))
        value = size * total ** (1 / (2 * power)) / self._before
        return value, value / total / size**2 * share * (F @ lower)

    def _unstable(self, x: FloatArray, K: Array) -> float:
        """Return the number of unstable poles of the loop, up to a constant: those of K less the turns of the loop."""
        blocks = self._shape.unpack(x)[0]
        poles = np.linalg.eigvals(blocks)
        own = np.sum(np.abs(poles) >= 1 if self._discrete else poles.real >= 0) * self._shape.copies
        return float(own - self._grid.turns(K))


def _lowered(cost: Any, x: FloatArray, steps: int) -> FloatArray:
    from scipy.optimize import minimize

    minimum = minimize(cost, x, jac=True, method="L-BFGS-B", options={"maxiter": steps, "maxcor": MEMORY})
    return np.asarray(minimum.x)


def _adjoint(M: Array) -> Array:
    return np.conj(np.swapaxes(M, 1, 2))
