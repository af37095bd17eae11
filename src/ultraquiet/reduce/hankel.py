"""Optimal Hankel-norm approximation."""

from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, whole
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.linalg import balance
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.linalg.ordered import Array, Matrices
from ultraquiet.reduce._abstract import ReductionResult, Weights, counted, joined, renamed, split
from ultraquiet.reduce.certificate import certified, fits, judging_plant, kept_promise
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

MINIMAL = 1e-13  # states with Hankel values below this share of the largest are round-off
REACHED = 1e-9  # of the largest singular value of the product of gains that belong to one Hankel value
EQUAL = 1e-7  # Hankel values as near as this, relatively, count as one


@register("reduce", "hankel")
@dataclass(frozen=True)
class HankelNorm:
    """Keep as many states as asked for with the smallest possible Hankel norm of the error: s_r+1, and no less.

    ||G - Gr||_H = s_r+1, and ||G - Gr|| <= s_r+1 + 2 (s_r+2 + ... + s_n) in the H-infinity norm.

    Args:
        states: states to keep, the unstable ones included; those are kept as they are. The fewest that leave out a
            hundredth when absent.
        slowest_hz: what decays slower than exp(-2 pi slowest_hz t) is kept as it is, like the unstable part.

    The error is as large at all frequencies, high ones included: the direct term moves. Where the law must fall at high
    frequency, take `Balanced`.

    >>> G = StateSpace([[-1.0, 0.0], [0.0, -9.0]], [[1.0], [1.0]], [[1.0, 0.1]], [[0.0]])
    >>> result = HankelNorm(states=1).reduce(G)
    >>> result.controller.states, bool(result.details["bound"] == result.hankel[1])
    (1, True)

    Glover 1984, doi:10.1080/00207178408933239; discrete systems go through the bilinear map, which keeps Hankel norms.
    """

    states: int | None = None
    slowest_hz: float = 0.0

    def __post_init__(self) -> None:
        if self.states is not None:
            whole("HankelNorm", "states", self.states, 0)
        between("HankelNorm", "slowest_hz", self.slowest_hz, 0.0, np.finfo(float).max, "Hz")

    @takes_systems
    @single_threaded
    def reduce(
        self, controller: StateSpace, plant: StateSpace | None = None, weights: Weights = None
    ) -> ReductionResult:
        """Return the reduced system; with a plant the loop is looked at afterwards.

        `details["bound"]` bounds the H-infinity norm of the error.
        """
        if plant is not None:
            fits("HankelNorm", controller, plant)
        if self.states is not None and self.states >= controller.states:
            # nothing is to be left out, be it round-off: the system is returned as it came
            P_loop = None if plant is None else judging_plant(plant, weights)
            hankel = _balanced_values(controller, self.slowest_hz)
            return certified(controller, controller, hankel, P=P_loop, details={"bound": 0.0})
        stable, kept, _ = split(controller, self.slowest_hz)
        values = partial(_balanced_values, controller, self.slowest_hz)
        keep = counted(self.states, kept[0].shape[0], stable[0].shape[0], values)
        discrete = controller.rate_hz is not None
        continuous = bilinear_to_continuous(*stable) if discrete else stable
        reduced, hankel, bound = hankel_approximation(continuous, keep)
        reduced = bilinear_to_discrete(*reduced) if discrete else reduced
        provenance = Provenance("HankelNorm", asdict(self), parents=(controller.hash,), versions=versions())
        small = renamed(joined(reduced, kept), controller, provenance)
        P_loop = None if plant is None else judging_plant(plant, weights)
        result = certified(controller, small, hankel, P=P_loop, details={"bound": bound})
        return kept_promise(result, controller, plant)


def _balanced_values(controller: StateSpace, slowest_hz: float) -> FloatArray:
    """Return the Hankel values of the part that decays faster than the slowest frequency."""
    stable, _, _ = split(controller, slowest_hz)
    R, L = balance.gramian_factors(*stable[:3], discrete=controller.rate_hz is not None)
    return np.asarray(np.linalg.svd(L.T @ R, compute_uv=False), dtype=np.float64)


def hankel_approximation(M: Matrices, order: int) -> tuple[Matrices, FloatArray, float]:
    """Return the best approximation of a stable continuous system, its Hankel values, and a bound on the error."""
    (A, B, C, D), hankel = _balanced(M)
    count = A.shape[0]
    if order >= count:
        return (A, B, C, D), hankel, 2 * float(np.sum(hankel[count:]))
    level = hankel[order]
    alike = np.abs(hankel[:count] - level) <= EQUAL * level
    whole_error = _allpass((A, B, C, D), hankel[:count], alike)
    T, inverse, stable = balance.stable_first(whole_error[0], discrete=False)
    a, b, c = inverse @ whole_error[0] @ T, inverse @ whole_error[1], whole_error[2] @ T
    keep = min(stable, int(np.argmax(alike)))
    smaller = hankel[int(np.argmax(alike)) + int(np.sum(alike)) :]
    bound = float(level + 2 * np.sum(smaller))
    return (a[:keep, :keep], b[:keep], c[:, :keep], whole_error[3]), hankel, bound


def _balanced(M: Matrices) -> tuple[Matrices, FloatArray]:
    """Return a balanced system without the states that are round-off, and the Hankel values of all.

    From factors of the Gramians, which know small values to all digits, counted from the largest.
    """
    R, L = balance.gramian_factors(*M[:3], discrete=False)
    left, right, hankel = balance.balancing_by(R, L, M[0].shape[0])
    count = int(np.sum(hankel > MINIMAL * hankel[0])) if hankel.size else 0
    return balance.truncate(M, left[:count], right[:, :count]), hankel


def _allpass(M: Matrices, hankel: FloatArray, alike: Array) -> Matrices:
    """Return the system whose difference from a balanced one has all singular values equal to one Hankel value.

    Its stable part is the approximation (Glover 1984, theorem 6.3). Inputs or outputs are filled up with zeros to a
    square system, for which the orthogonal U with B2 = -C2' U exists.
    """
    A, B, C, D = M
    p, m = D.shape
    size = max(p, m)
    B, C = np.pad(B, ((0, 0), (0, size - m))), np.pad(C, ((0, size - p), (0, 0)))
    rest, s = ~alike, float(np.mean(hankel[alike]))
    U = _turned(C[:, alike] @ B[alike])
    S = hankel[rest]
    A1, B1, C1 = A[np.ix_(rest, rest)], B[rest], C[:, rest]
    # theorem 6.3 in states that stay as large as the balanced ones, where its own grow with 1 / (S^2 - s^2)
    gap = S * S - s * s
    left, right = (np.sign(gap) / np.sqrt(np.abs(gap)))[:, None], 1 / np.sqrt(np.abs(gap))
    a = left * (s * s * A1.T + S[:, None] * A1 * S - s * C1.T @ U @ B1.T) * right
    b = left * (S[:, None] * B1 + s * C1.T @ U)
    c = (C1 * S + s * U @ B1.T) * right
    d = np.pad(D, ((0, size - p), (0, size - m))) - s * U
    return a, b[:, :m], c[:p], d[:p, :m]


def _turned(M: Array) -> Array:
    """Return the orthogonal U that turns the inputs of M against its outputs, -U the orthogonal factor of M.

    What M does not reach is left to choice: there -U turns as little as it can, whatever vectors span it.
    """
    Z, values, Yt = np.linalg.svd(M)
    rank = int(np.sum(values > REACHED * values[0]))
    left, right = Z[:, rank:], Yt[rank:]
    P, _, Qt = np.linalg.svd(left.T @ right.T)
    return -(Z[:, :rank] @ Yt[:rank] + left @ P @ Qt @ right)
