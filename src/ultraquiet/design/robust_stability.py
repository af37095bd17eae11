"""Robust stability under a bound on the plant's relative error: measured on the finished loop, and designed for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ultraquiet.analyse.margins import default_grid
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design.result import STABLE_WORDS, DesignResult
from ultraquiet.linalg.modal_response import residues
from ultraquiet.linalg.response import points
from ultraquiet.values.interconnect import feedback, lft, series
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

LOWEST = 0.02  # of the height asked for: below this share nothing worth calling performance is left
BETWEEN = 0.99  # what the search asks on its lines, so that the exact norm of the result is below one between them too
STEPS = 6  # halvings of the logarithm of that range: 6 % in height


def robust_stability(plant: StateSpace, controller: StateSpace, bound: StateSpace) -> float:
    """Return max over f of ||W T||, T = G K (I - G K)^-1: below one, no error within the bound unsettles the loop.

    Args:
        plant: G.
        controller: K, u = K y, which stabilises it.
        bound: W, the relative error at the plant's outputs, G_true = (I + E) G with ||E|| <= |W|.

    >>> from ultraquiet.values.interconnect import gain
    >>> G, K = (gain([[k]]) for k in (1.0, -3.0))
    >>> robust_stability(G, K, gain([[0.5]]))
    0.375

    Skogestad and Postlethwaite 2005, section 8.6.
    """
    ny = plant.D.shape[0]
    one = np.eye(ny)
    P = StateSpace(
        plant.A,
        np.hstack([np.zeros((plant.states, ny)), plant.B]),
        np.vstack([plant.C, plant.C]),
        np.block([[0 * one, plant.D], [one, plant.D]]),
        plant.rate_hz,
    )
    return hinf_norm(series(lft(P, controller), bound))[0]


def stands(plant: StateSpace, result: DesignResult, bound: StateSpace | None) -> DesignResult:
    """Return a result with `robust_stability` in its details; a loop that does not stand the bound is `not robust`."""
    if bound is None or result.controller is None or result.status.word not in STABLE_WORDS:
        return result
    size = robust_stability(plant, result.controller, bound)
    details = {**result.details, "robust_stability": size}
    if size < 1:
        sentence = f"{result.status.sentence} It stands every error within the uncertainty: ||W T|| = {size:.3g} < 1."
        return replace(result, status=Status(result.status.word, sentence), details=details)
    sentence = (
        f"The loop is stable with the design model but need not be with the plant: ||W T|| reaches {size:.3g} where "
        "the uncertainty allows less than one; ask for less, or identify the plant better where the weight is high."
    )
    return replace(result, status=Status(StatusWord.NOT_ROBUST, sentence), details=details)


def tallest(
    plant: StateSpace,
    bound: StateSpace,
    height: float,
    law: Callable[[float], StateSpace | None],
    design: Callable[[float], DesignResult],
) -> DesignResult:
    """Return the design of the largest height, at most the one asked for, whose loop stands the bound.

    `law` gives the controller of a height alone, which is all that the search needs; `design` the whole result.
    """
    f = np.unique(np.concatenate([default_grid(plant), default_grid(bound)]))
    z = points(f, plant.rate_hz)
    G, W = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (plant, bound))

    def enough(share: float) -> bool:
        K = law(height * share)
        if K is None or not feedback(plant, K).is_stable():
            return False
        L = G @ np.moveaxis(residues(K.A, K.B, K.C, K.D).at(z), 2, 0)
        T = np.linalg.solve(np.eye(L.shape[1]) - L, L)
        return float(np.linalg.norm(W @ T, 2, axis=(1, 2)).max()) < BETWEEN

    first = stands(plant, design(height), bound)
    if first.status.word != StatusWord.NOT_ROBUST or not enough(LOWEST):
        return first
    low, high = np.log(LOWEST), 0.0
    for _ in range(STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if enough(float(np.exp(middle))) else (low, middle)
    return stands(plant, design(height * float(np.exp(low))), bound)
