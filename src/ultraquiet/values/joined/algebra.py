"""Arithmetic of linear systems: sums, products, feedback, side by side."""

from collections.abc import Sequence
from typing import Any, Self, cast

import numpy as np

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.linalg.even import even_scale
from ultraquiet.values.channel import Channel
from ultraquiet.values.joined.wires import apart, meet, places, unswapped

SINGULAR = 1e-12  # what is left of I - D D, as a share of what it was made of, when a loop has no solution
Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Wires = tuple[tuple[Channel, ...], tuple[Channel, ...]]


class Algebra:
    """Operators of a system. `G * K` lets K act first, as matrices do; numbers and matrices are gains.

    Both sides must share their rate and, where they meet, their units; channels that were only numbered fit any.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    rate_hz: float | None
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def _joined(self, matrices: Matrices, wires: Wires) -> Self:
        """Return a system of the same kind and rate; the noise of an innovation form is left out."""
        raise NotImplementedError

    def __add__(self, other: Any) -> Self:
        right = self._system("+", other, like=True)
        wires = (
            meet("StateSpace +", self.actuators, right.actuators, "the inputs"),
            meet("StateSpace +", self.sensors, right.sensors, "the outputs"),
        )
        B, C = np.vstack([self.B, right.B]), np.hstack([self.C, right.C])
        return self._joined((_diagonal(self.A, right.A), B, C, self.D + right.D), wires)

    def __radd__(self, other: Any) -> Self:
        return self + other

    def __neg__(self) -> Self:
        return self._joined((self.A, self.B, -self.C, -self.D), (self.actuators, self.sensors))

    def __sub__(self, other: Any) -> Self:
        return self + -self._system("-", other, like=True)

    def __rsub__(self, other: Any) -> Self:
        return -self + other

    def __mul__(self, other: Any) -> Self:
        if _is_number(other):
            g = float(other)
            return self._joined((self.A, g * self.B, self.C, g * self.D), (self.actuators, self.sensors))
        return self @ other

    def __rmul__(self, other: Any) -> Self:
        if _is_number(other):
            return self * other
        return self.__rmatmul__(other)

    def __matmul__(self, other: Any) -> Self:
        return self._series(self, self._system("@", other, shape=(len(self.actuators), len(self.actuators))))

    def __rmatmul__(self, other: Any) -> Self:
        return self._series(self._system("@", other, shape=(len(self.sensors), len(self.sensors))), self)

    # NumPy would take a system for an element of an array.
    __array_ufunc__ = None

    def feedback(self, controller: Any, sign: int = 1) -> Self:
        """Return (I - s G K)^-1 G with u = d + s K y: from what is added to the inputs to the outputs.

        Args:
            controller: K, a system or a gain `(nu, ny)`. This package's laws carry their sign inside.
            sign: s; +1 here, where other packages subtract: give -1 for theirs.

        Returns:
            The closed loop with this system's channels.

        Raises:
            InputError: shapes or units that do not meet, or a loop without solution (I - s D_G D_K singular).
            RateError: other rates.

        >>> from ultraquiet.values import StateSpace
        >>> lag = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
        >>> lag.feedback(-0.25).A.tolist(), lag.feedback(0.25, sign=-1).A.tolist()
        ([[0.25]], [[0.25]])
        """
        ny, nu = self.D.shape
        K = self._system("feedback", controller, shape=(nu, ny))
        if K.D.shape != (nu, ny):
            raise InputError(f"feedback: the controller is {K.D.shape} (outputs, inputs), the plant takes {(nu, ny)}.")
        unswapped("feedback", K, self)
        meet("feedback", self.sensors, K.actuators, "the plant's outputs and the controller's inputs")
        meet("feedback", self.actuators, K.sensors, "the plant's inputs and the controller's outputs")
        Ck, Dk = sign * K.C, sign * K.D
        loop = np.eye(ny) - self.D @ Dk
        if is_singular(loop, self.D, Dk):
            raise InputError("feedback: the loop has no solution, I - D K is singular; put a delay into it.")
        # y = loop^-1 (C x + D Ck xk + D d), u = d + Ck xk + Dk y, over the columns [x, xk, d]
        y = np.linalg.solve(loop, np.hstack([self.C, self.D @ Ck, self.D]))
        n, nk = self.A.shape[0], K.A.shape[0]
        u = np.hstack([np.zeros((nu, n)), Ck, np.eye(nu)]) + Dk @ y
        top = np.hstack([self.A, np.zeros((n, nk + nu))]) + self.B @ u
        low = np.hstack([np.zeros((nk, n)), K.A, np.zeros((nk, nu))]) + K.B @ y
        states = np.vstack([top, low])
        y[:, n : n + nk] *= (even := _even(states[:n, n : n + nk], states[n:, :n]))
        states[:, n : n + nk] *= even
        states[n:] /= even
        C, D = np.asarray(y[:, : n + nk], dtype=np.float64), np.asarray(y[:, n + nk :], dtype=np.float64)
        matrices = states[:, : n + nk], states[:, n + nk :], C, D
        return self._joined(matrices, (self.actuators, self.sensors))

    def pick(self, inputs: Sequence[int | str] | None = None, outputs: Sequence[int | str] | None = None) -> Self:
        """Return the system between some of its channels, by index from 0 or by name; all of a side when absent.

        Raises:
            InputError: no such channel.

        >>> from ultraquiet.values import StateSpace
        >>> both = StateSpace([[0.5]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]], 1.0, ["force", "heat"], ["speed"])
        >>> both.pick(inputs=["heat"]).B
        array([[2.]])
        """
        sides = (inputs, self.actuators), (outputs, self.sensors)
        j, i = (places("StateSpace.pick", side, wires) for side, wires in sides)
        wires = tuple(self.actuators[k] for k in j), tuple(self.sensors[k] for k in i)
        return self._joined((self.A, self.B[:, j], self.C[i], self.D[np.ix_(i, j)]), wires)

    def append(self, *others: Any) -> Self:
        """Return the systems side by side, diag(G1, G2, ...): each keeps its own inputs and outputs.

        Raises:
            RateError: other rates.

        >>> from ultraquiet.values import StateSpace
        >>> lag = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0, ["force"], ["speed"])
        >>> [c.name for c in lag.append(lag).sensors]
        ['speed', 'speed']
        """
        out = self
        for each in others:
            right = self._system("append", each)
            A, B, C, D = (_diagonal(getattr(out, k), getattr(right, k)) for k in "ABCD")
            wires = (
                apart(out.actuators, right.actuators, "input"),
                apart(out.sensors, right.sensors, "output"),
            )
            out = out._joined((A, B, C, D), wires)
        return out

    def _series(self, second: Self, first: Self) -> Self:
        """Return second * first."""
        meet("StateSpace @", second.actuators, first.sensors, "the left side's inputs and the right side's outputs")
        n1, n2 = first.A.shape[0], second.A.shape[0]
        drive = second.B @ first.C
        even = _power_of_two(_size(first.A) + _size(second.A), _size(drive)) ** 2
        A = np.block([[first.A, np.zeros((n1, n2))], [even * drive, second.A]])
        B = np.vstack([first.B, even * (second.B @ first.D)])
        C = np.hstack([second.D @ first.C, second.C / even])
        return self._joined((A, B, C, second.D @ first.D), (first.actuators, second.sensors))

    def _system(self, sign: str, other: Any, *, like: bool = False, shape: tuple[int, int] | None = None) -> Self:
        """Return the other operand as a system of this rate: a number is a gain in every channel."""
        if isinstance(other, Algebra):
            same_rate(f"StateSpace {sign}", "the left side", self.rate_hz, "the right side", other.rate_hz)
            return cast("Self", other)
        try:
            gain = np.asarray(other, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                f"StateSpace {sign}: takes a system, a number or a matrix, got {type(other).__name__}."
            ) from None
        ny, nu = shape or self.D.shape
        if gain.ndim == 0 and like:  # added to every entry, as to a matrix
            gain = np.full((ny, nu), float(gain))
        elif gain.ndim == 0:
            gain = float(gain) * np.eye(ny, nu)
        if gain.ndim != 2:
            raise InputError(f"StateSpace {sign}: a gain must be a number or a matrix, got shape {gain.shape}.")
        p, m = gain.shape
        wires = tuple(tuple(Channel(f"{word} {k + 1}") for k in range(n)) for word, n in (("input", m), ("output", p)))
        matrices = np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), gain
        return self._joined(matrices, (wires[0], wires[1]))


def is_singular(loop: FloatArray, D: FloatArray, Dk: FloatArray) -> bool:
    """Return whether I - D Dk is nothing but the rounding of what it was made of, in any units of its channels."""
    made_of = np.abs(D) @ np.abs(Dk)  # units of the commands cancel here, those of the outputs by the scale
    n = made_of.shape[0]
    d = even_scale(made_of, np.zeros((n, 0)), np.zeros((0, n)))
    even, made = loop * d / d[:, None], made_of * d / d[:, None]
    return bool(np.linalg.svd(even, compute_uv=False).min(initial=np.inf) < SINGULAR * (1 + np.linalg.norm(made)))


def _even(onto: FloatArray, back: FloatArray) -> float:
    """Return a power of two for the second system's states, so that what couples two systems is of one size.

    A plant in nanometres and a law in volts per nanometre otherwise meet in a matrix of which rounding leaves little.
    """
    return _power_of_two(_size(back), _size(onto))


def _size(matrix: FloatArray) -> float:
    return float(np.abs(matrix).max(initial=0.0))


def _power_of_two(wanted: float, had: float) -> float:
    """Return the power of two, which rounds nothing, nearest to the root of a ratio; one where a side is zero."""
    return 2.0 ** round(0.5 * float(np.log2(wanted / had))) if min(wanted, had) > 0 else 1.0


def _is_number(other: Any) -> bool:
    return isinstance(other, int | float) or any(
        np.issubdtype(cast("type[Any]", type(other)), kind) for kind in (np.integer, np.floating)
    )


def _diagonal(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return two matrices along the diagonal; unlike SciPy's, blocks without rows or columns keep their place."""
    out = np.zeros((one.shape[0] + other.shape[0], one.shape[1] + other.shape[1]))
    out[: one.shape[0], : one.shape[1]] = one
    out[one.shape[0] :, one.shape[1] :] = other
    return out
