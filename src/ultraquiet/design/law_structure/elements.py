"""Tunable parts of controllers: a response at any complex frequency, and its derivatives after every parameter.

All live in the plane s = (z - 1) / (z + 1) of the bilinear map (in scaled rad/s when time is continuous), where the
left half is stable for both times, corners are logarithms and gains keep their size.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices

# zeta of random starts' poles, and where their input and output gains lie
START_ZETA = (0.2, 1.0)
START_GAIN = 0.3
WORST_PAIR = 1e6  # condition of the change of coordinates into pairs
SLOWEST = 1e-6  # of poles, in the plane
LEAST_SHARE = 0.05  # of the largest parameter: a smaller one moves by as much


class Element(Protocol):
    """A controller of known shape whose parameters are free."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        ...

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, output, input)`."""
        ...

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        ...

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        ...

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        ...

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change of each parameter is."""
        ...

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start with poles between two frequencies."""
        ...


@dataclass(frozen=True, eq=False)
class Dense:
    """A state space of given order whose every entry is free, stable or not.

    Args:
        states: order.
        outputs, inputs: r, c.
    """

    states: int
    outputs: int
    inputs: int

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.outputs, self.inputs

    @property
    def size(self) -> int:
        """Number of parameters."""
        return (self.states + self.outputs) * (self.states + self.inputs)

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        n, M = self.states, theta.reshape(self.states + self.outputs, self.states + self.inputs)
        return M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:]

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, output, input)`."""
        A, B, C, D = self.system(theta)
        right = np.broadcast_to(B, (s.size, *B.shape))
        return C @ np.linalg.solve(s[:, None, None] * np.eye(self.states) - A, right) + D

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        A, B, C, _ = self.system(theta)
        pencil = s[:, None, None] * np.eye(self.states) - A
        inside = np.linalg.solve(pencil, (right @ B.T)[:, :, None])[:, :, 0]
        outside = np.linalg.solve(pencil.swapaxes(1, 2), (left @ C)[:, :, None])[:, :, 0]
        return _outer(outside, left, inside, right).reshape(s.size, self.size)

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        M = theta.reshape(self.states + self.outputs, -1).copy()
        M[self.states :] *= factor
        return M.ravel()

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change of each parameter is."""
        return np.maximum(np.abs(theta), LEAST_SHARE * max(float(np.abs(theta).max(initial=0.0)), LEAST_SHARE))

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start with poles between two frequencies."""
        sections = StablePairs(self.states, self.outputs, self.inputs, np.ones(self.states))
        A, B, C, D = sections.system(sections.start(rng, low, high))
        return np.block([[A, B], [C, D]]).ravel()


@dataclass(frozen=True, eq=False)
class StablePairs:
    """A stable state space of given order in pairs of states, A = [[0, w], [-w, -d]] with w = e^p, d = e^q.

    Pairs may be complex or real, change from one to the other smoothly and never leave the left half; an odd state is
    one real pole -e^p. B, C and D are free, scaled with the speed at which each pair began.

    Args:
        states: order.
        outputs, inputs: r, c.
        speeds: scale of every state, alike within a pair.
    """

    states: int
    outputs: int
    inputs: int
    speeds: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.outputs, self.inputs

    @property
    def size(self) -> int:
        """Number of parameters: one for each state's pole, then B, C and D."""
        return self.states * (1 + self.inputs + self.outputs) + self.outputs * self.inputs

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        n, r, c = self.states, self.outputs, self.inputs
        root = np.sqrt(self.speeds)
        e = np.exp(np.clip(theta[:n], np.log(SLOWEST), -np.log(SLOWEST)))
        A, k = np.zeros((n, n)), np.arange(0, n - 1, 2)
        A[k, k + 1], A[k + 1, k], A[k + 1, k + 1] = e[k], -e[k], -e[k + 1]
        if n % 2:
            A[-1, -1] = -e[-1]
        B = theta[n : n + n * c].reshape(n, c) * root[:, None]
        C = theta[n + n * c : n + n * (c + r)].reshape(r, n) * root
        return A, B, C, theta[n + n * (c + r) :].reshape(r, c)

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, output, input)`."""
        A, B, C, D = self.system(theta)
        return C @ self._solve(A, s, np.broadcast_to(B, (s.size, *B.shape))) + D

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        A, B, C, _ = self.system(theta)
        n, m, root = self.states, s.size, np.sqrt(self.speeds)
        inside = self._solve(A, s, (right @ B.T)[:, :, None])[:, :, 0]
        outside = self._solve(A.T, s, (left @ C)[:, :, None])[:, :, 0]
        k, poles = np.arange(0, n - 1, 2), np.zeros((m, n), dtype=np.complex128)
        cross = outside[:, k] * inside[:, k + 1] - outside[:, k + 1] * inside[:, k]
        poles[:, k] = A[k, k + 1] * cross
        poles[:, k + 1] = A[k + 1, k + 1] * outside[:, k + 1] * inside[:, k + 1]
        if n % 2:
            poles[:, -1] = A[-1, -1] * outside[:, -1] * inside[:, -1]
        of_b = (outside * root)[:, :, None] * right[:, None, :]
        of_c = left[:, :, None] * (inside * root)[:, None, :]
        of_d = left[:, :, None] * right[:, None, :]
        return np.hstack([poles, *(part.reshape(m, part[0].size) for part in (of_b, of_c, of_d))])

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        out, first = theta.copy(), self.states * (1 + self.inputs)
        out[first:] *= factor
        return out

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change of each parameter is."""
        return np.maximum(np.abs(theta), LEAST_SHARE * max(float(np.abs(theta).max(initial=0.0)), LEAST_SHARE))

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start with poles between two frequencies."""
        theta = START_GAIN * rng.standard_normal(self.size)
        w = rng.uniform(np.log(low), np.log(high), self.states)
        theta[: self.states] = w
        k = np.arange(0, self.states - 1, 2)
        theta[k + 1] = w[k] + np.log(2 * rng.uniform(*START_ZETA, k.size))
        return theta

    def _solve(self, A: FloatArray, s: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return (s - A)^-1 right, pair by pair in closed form: [[s - d, b], [c, s - a]] / det."""
        out, n = np.empty(right.shape, dtype=np.complex128), self.states
        k = np.arange(0, n - 1, 2)
        a, b, c, d = A[k, k], A[k, k + 1], A[k + 1, k], A[k + 1, k + 1]
        det = ((s[:, None] - a) * (s[:, None] - d) - b * c)[:, :, None]
        top, low = right[:, k], right[:, k + 1]
        out[:, k] = ((s[:, None] - d)[:, :, None] * top + b[:, None] * low) / det
        out[:, k + 1] = (c[:, None] * top + (s[:, None] - a)[:, :, None] * low) / det
        if n % 2:
            out[:, -1] = right[:, -1] / (s - A[-1, -1])[:, None]
        return out


def from_system(M: Matrices) -> tuple[StablePairs, FloatArray] | None:
    """Return a stable system as sections and their parameters; None where its modes cannot be told apart."""
    form = balance.modal(*M[:3])
    if any(size > 2 for size in form.blocks) or (M[0].size and np.linalg.eigvals(M[0]).real.max() >= 0):
        return None
    pairs, singles, at = [], [], 0
    for size in form.blocks:
        (pairs if size == 2 else singles).extend(range(at, at + size))
        at += size
    singles.sort(key=lambda k: form.A[k, k])
    order = pairs + singles
    n, r, c = len(order), M[2].shape[0], M[1].shape[1]
    A, T, poles, speeds = form.A[np.ix_(order, order)], np.eye(n), np.zeros(n), np.ones(n)
    for k in range(0, n - 1, 2):
        block = A[k : k + 2, k : k + 2]
        w = np.sqrt(np.linalg.det(block))
        # A t1 = -w t2 makes [[0, w], [-w, -d]] of any block; the first vector must not be one of its eigenvectors
        first = np.array([1.0, 0.0 if block[0, 1] else 1.0])
        T[k : k + 2, k : k + 2] = np.column_stack([first, -block @ first / w])
        poles[k : k + 2], speeds[k : k + 2] = (np.log(w), np.log(-np.trace(block))), w
    if n % 2:
        poles[-1], speeds[-1] = np.log(-A[-1, -1]), -A[-1, -1]
    if n and np.linalg.cond(T) > WORST_PAIR:
        return None
    root = np.sqrt(speeds)
    B, C = np.linalg.solve(T, form.B[order]), form.C[:, order] @ T
    theta = np.concatenate([poles, (B / root[:, None]).ravel(), (C / root).ravel(), M[3].ravel()])
    return StablePairs(n, r, c, speeds), theta


def _outer(outside: ComplexArray, left: ComplexArray, inside: ComplexArray, right: ComplexArray) -> ComplexArray:
    rows, columns = np.hstack([outside, left]), np.hstack([inside, right])
    return rows[:, :, None] * columns[:, None, :]
