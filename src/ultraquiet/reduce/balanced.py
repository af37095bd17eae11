"""Balanced reduction without regard to the loop."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import one_of, whole
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.reduce._abstract import METHODS, ReductionResult, project, renamed
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status


@register("reduce", "balanced")
@dataclass(frozen=True)
class Balanced:
    """Keep the states that pass most energy from input to output; an unstable part is kept whole.

    ||G - Gr|| <= 2 (s_r+1 + ... + s_n), s the Hankel values of the stable part.

    Args:
        states: states to keep, the unstable ones included.
        method: `truncation` (exact at infinite frequency when continuous) or `perturbation` (exact at 0 Hz).

    >>> G = StateSpace([[0.9, 0.0], [0.0, 0.1]], [[1.0], [0.01]], [[1.0, 0.01]], [[0.0]], rate_hz=1.0)
    >>> result = Balanced(states=1).reduce(G)
    >>> result.controller.states, result.details["bound"] < 1e-3
    (1, True)

    Moore 1981, doi:10.1109/TAC.1981.1102568; the bound: Glover 1984, doi:10.1080/00207178408933239.
    """

    states: int = 36
    method: str = "truncation"

    def __post_init__(self) -> None:
        whole("Balanced", "states", self.states, 0)
        one_of("Balanced", "method", self.method, METHODS)

    def reduce(self, controller: StateSpace, plant: StateSpace | None = None, weights: Any = None) -> ReductionResult:
        """Return the reduced system; the loop does not steer it, which is this method's weakness.

        With a plant the loop is looked at afterwards, and a lost one is called `unstable`. `details["bound"]` is the
        a-priori bound on the H-infinity norm of the error.
        """
        del weights
        discrete = controller.rate_hz is not None
        T, inverse, count = balance.stable_first(controller.A, discrete)
        A, B, C = inverse @ controller.A @ T, inverse @ controller.B, controller.C @ T
        stable = (A[:count, :count], B[:count], C[:, :count], controller.D)
        P, Q = balance.gramians(*stable[:3], discrete)
        keep = max(0, min(self.states - (controller.states - count), count))
        (a, b, c, d), hankel = project(stable, P, Q, keep, discrete, self.method)
        whole_system: Matrices = (
            block_diag(a, A[count:, count:]) if count < controller.states else a,
            np.vstack([b, B[count:]]),
            np.hstack([c, C[:, count:]]),
            d,
        )
        bound = 2 * float(np.sum(hankel[keep:]))
        settings = {"states": self.states, "method": self.method}
        made = Provenance("Balanced", settings, parents=(controller.hash,), versions=versions())
        small = renamed(whole_system, controller, made)
        kept = f"{small.states} of {controller.states} states kept; the error is at most {bound:.3g}"
        status = Status("ok", f"{kept}.")
        if plant is not None and not sensitivity(plant, small).is_stable():
            status = Status("unstable", f"{kept}, and the loop is lost; keep more or weigh by the loop.")
        return ReductionResult(status, small, hankel, details={"bound": bound}, provenance=made)
