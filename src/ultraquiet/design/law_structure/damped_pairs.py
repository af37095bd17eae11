"""Tunable parts whose poles stay damped: second-order sections of free frequency, and resonators of a given one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.law_structure.elements import START_ZETA, StablePairs
from ultraquiet.linalg.ordered import Matrices

LEAST_SHARE = 0.05  # of the largest of its kind: a smaller number moves by as much
FASTEST = 13.0  # logarithms of frequencies and dampings stay within this of zero


@dataclass(frozen=True, eq=False)
class DampedPairs:
    """Second-order sections in parallel plus a constant, k = D + sum N_i(s) / (s^2 + 2 zeta_i w_i s + w_i^2).

    w = e^p and zeta = floor + e^q: stable, and never less damped than the floor, whatever the parameters. They are
    `StablePairs` in other coordinates. A law of one input has numerators alone for B and C, which leaves no parameter
    that moves nothing.

    Args:
        states: order, even.
        outputs, inputs: r, c.
        speeds: scale of every state, alike within a pair.
        floor: least damping ratio.
    """

    states: int
    outputs: int
    inputs: int
    speeds: FloatArray
    floor: float

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.outputs, self.inputs

    @property
    def size(self) -> int:
        """Number of parameters: frequencies, dampings, B where there are several inputs, C, D."""
        return self.pairs.size - (self.states if self.inputs == 1 else 0)

    @cached_property
    def pairs(self) -> StablePairs:
        """The same law in its other coordinates."""
        return StablePairs(self.states, self.outputs, self.inputs, self.speeds)

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        return self.pairs.system(self._inner(theta))

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, output, input)`."""
        return self.pairs.response(self._inner(theta), s)

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        n, m = self.states, self.states // 2
        inner = self.pairs.gradient(self._inner(theta), s, left, right)
        extra = np.exp(np.clip(theta[m:n], -FASTEST, FASTEST))
        speed, damping = inner[:, 0:n:2], inner[:, 1:n:2]
        # p enters both w and the width 2 zeta w
        own = [speed + damping, damping * extra / (self.floor + extra)]
        return np.hstack([*own, inner[:, n + (n if self.inputs == 1 else 0) :]])

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        out, first = theta.copy(), self.states * (1 if self.inputs == 1 else 1 + self.inputs)
        out[first:] *= factor
        return out

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change is: one for logarithms, its share of the largest of B, C or D for the others."""
        n, r, c = self.states, self.outputs, self.inputs
        own, at = np.ones(self.size), n
        for count in ([n * c] if c > 1 else []) + [n * r, r * c]:
            part = np.abs(theta[at : at + count])
            top = float(part.max(initial=0.0)) or 1.0
            own[at : at + count] = np.maximum(part, LEAST_SHARE * top)
            at += count
        return own

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start with poles between two frequencies."""
        m = self.states // 2
        theta = 0.3 * rng.standard_normal(self.size)
        theta[:m] = rng.uniform(np.log(low), np.log(high), m)
        theta[m : 2 * m] = np.log(rng.uniform(*START_ZETA, m))
        return theta

    def _inner(self, theta: FloatArray) -> FloatArray:
        """Return the parameters of the same law as stable pairs."""
        n, m = self.states, self.states // 2
        p, q = (np.clip(part, -FASTEST, FASTEST) for part in (theta[:m], theta[m:n]))
        poles = np.column_stack([p, p + np.log(2 * (self.floor + np.exp(q)))]).ravel()
        entered = [np.tile([0.0, 1.0], m)] if self.inputs == 1 else []
        return np.concatenate([poles, *entered, theta[n:]])


def damped(pairs: StablePairs, theta: FloatArray, floor: float) -> tuple[DampedPairs, FloatArray]:
    """Return a law of stable pairs as one of damped pairs; poles below the floor are lifted to just above it."""
    n = pairs.states
    own = DampedPairs(n, pairs.outputs, pairs.inputs, pairs.speeds, floor)
    p = theta[0:n:2]
    zeta = np.exp(theta[1:n:2] - p) / 2
    poles = np.concatenate([p, np.log(np.maximum(zeta - floor, 0.1 * floor))])
    if pairs.inputs > 1:
        return own, np.concatenate([poles, theta[n:]])
    _, B, C, D = pairs.system(theta)
    w, d = np.exp(p), np.exp(theta[1:n:2])
    (b1, b2), c = (B[0::2, 0], B[1::2, 0]), (C[:, 0::2], C[:, 1::2])
    # C adj(s - A) B with A = [[0, w], [-w, -d]], read off in powers of s
    through, level = c[0] * b1 + c[1] * b2, c[0] * (d * b1 + w * b2) - c[1] * w * b1
    speed = pairs.speeds[0:n:2]
    numerators = np.stack([level / (w * speed), through / speed], axis=2).reshape(pairs.outputs, n)
    return own, np.concatenate([poles, numerators.ravel(), D.ravel()])


@dataclass(frozen=True, eq=False)
class Resonances:
    """Resonators at given frequencies with free numerators, k = sum (b s + a w) w / (s^2 + 2 zeta w s + w^2).

    Args:
        w: centres in the plane.
        zeta: damping ratios.
        outputs, inputs: r, c; every resonator has two states an input.
    """

    w: FloatArray
    zeta: FloatArray
    outputs: int
    inputs: int

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.outputs, self.inputs

    @property
    def size(self) -> int:
        """Number of parameters, `(resonator, a or b, output, input)`."""
        return 2 * self.w.size * self.outputs * self.inputs

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return `(frequency, output, input)`."""
        N = theta.reshape(2 * self.w.size, self.outputs, self.inputs)
        return np.tensordot(self._basis(s), N, axes=1)

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dk / dtheta) right for each frequency, `(frequency, size)`."""
        del theta
        outer = left[:, :, None] * right[:, None, :]
        return (self._basis(s)[:, :, None, None] * outer[:, None]).reshape(s.size, self.size)

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D."""
        c, one = self.inputs, np.eye(self.inputs)
        A = np.zeros((2 * c * self.w.size,) * 2)
        B, C = np.zeros((len(A), c)), np.zeros((self.outputs, len(A)))
        N = theta.reshape(self.w.size, 2, self.outputs, c)
        for i, (w, zeta) in enumerate(zip(self.w, self.zeta, strict=True)):
            first, second = slice(2 * c * i, 2 * c * i + c), slice(2 * c * i + c, 2 * c * (i + 1))
            A[first, second], A[second, first], A[second, second] = w * one, -w * one, -2 * zeta * w * one
            B[second] = np.sqrt(w) * one
            C[:, first], C[:, second] = np.sqrt(w) * N[i, 0], np.sqrt(w) * N[i, 1]
        return A, B, C, np.zeros((self.outputs, c))

    def turned_down(self, theta: FloatArray, factor: float) -> FloatArray:
        """Return the parameters of factor times the law."""
        return theta * factor

    def sizes(self, theta: FloatArray) -> FloatArray:
        """Return what a unit of change is: the damping, at which a resonator's peak is about one, or what there is."""
        zeta = np.repeat(self.zeta, 2 * self.outputs * self.inputs)
        return np.maximum(np.abs(theta), zeta)

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return no resonance at all."""
        del rng, low, high
        return np.zeros(self.size)

    def _basis(self, s: ComplexArray) -> ComplexArray:
        """Return w^2 / den and w s / den of every resonator, `(frequency, 2 resonators)`."""
        den = s[:, None] ** 2 + 2 * self.zeta * self.w * s[:, None] + self.w**2
        return np.stack([self.w**2 / den, self.w * s[:, None] / den], axis=2).reshape(s.size, -1)
