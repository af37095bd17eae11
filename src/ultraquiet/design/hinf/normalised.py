"""The four-block problem with all weights one, on a plant in units of its own whose loop is shaped over a band."""

from dataclasses import replace

import numpy as np

from ultraquiet.analyse.plant_scale import HIGHEST, EvenPlant, even_plant
from ultraquiet.design.hinf.coprime_stabilisation import central_law, smallest_norm
from ultraquiet.design.hinf.synthesis import synthesize_expected
from ultraquiet.design.result import DesignResult
from ultraquiet.design.weights.filters import band_pass, low_pass, reciprocal, with_tones
from ultraquiet.values.generalised import four_block
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace

FLOOR = 0.1  # share of the loop's gain that is asked for outside the band
EDGES = 2  # states of the shape: one slope on each side
WIDER = 1.5  # the shape's corners lie outside the band by this factor: its edges are whole inside


def normalised_four_block(even: EvenPlant, g: float, shape: StateSpace, margin: float) -> DesignResult:
    """Return the controller K = Ks W of the even plant that minimises ||[I; Ks] (I - Gs Ks)^-1 [Gs, I]||, Gs = W Ge.

    W is g times the shape on every output. A norm b of this loop keeps, at either end of Gs and in all channels at
    once, a disk of about 2 / b: gains and phases that move together and apart are one and the same to it.

    Args:
        even: Ge.
        g: gain of the loop where the shape is one.
        shape: one channel, `(1, 1)`.
        margin: over the smallest norm.

    Glover and McFarlane 1989, doi:10.1109/9.29404.
    """
    ny, nu = even.plant.D.shape
    rate = even.plant.rate_hz
    W = _weight(even, g, shape)
    Gs = series(even.plant, W)
    P = four_block(Gs, gain(np.eye(ny), rate), gain(np.eye(nu), rate), np.eye(nu), np.eye(ny))
    found = synthesize_expected(P, ny, nu, smallest_norm(Gs), margin)
    on_loop = _on_loop(even, series(shape, gain([[g]], rate)))
    details = {**found.details, "weights": even.weights(W, gain(np.eye(nu), rate)), "loop_weights": on_loop}
    law = None if found.controller is None else series(W, found.controller)
    return replace(found, controller=law, details=details)


def _on_loop(even: EvenPlant, one: StateSpace) -> dict[str, StateSpace]:
    """Return what the norm b of this loop says of S and KS in the plant's units, by one channel w of the shape.

    Two of its blocks are Se and Ke Se / w. With S = Y^-1 Se Y and K S = U (Ke Se) Y, Y and U what evens out the
    channels, sigma(S) <= b max(Y) / min(Y) and sigma(K S) <= b |w| max(U) max(Y).
    """
    y, u, rate = even.outputs, even.inputs, one.rate_hz
    least = gain([[1.0 / (y.max(initial=0.0) * u.max(initial=0.0))]], rate)
    return {"S": gain([[y.min(initial=np.inf) / y.max(initial=0.0)]], rate), "KS": series(reciprocal(one), least)}


def normalised_sketch(even: EvenPlant, g: float, shape: StateSpace, margin: float) -> StateSpace | None:
    """Return about the controller that `normalised_four_block` finds, from two equations and unverified.

    It is the central one of the same problem in coprime factors, at the same level; None where the formulas give none.

    Args:
        even: Ge.
        g: gain of the loop where the shape is one.
        shape: one channel, `(1, 1)`.
        margin: over the smallest norm.

    McFarlane and Glover 1992, doi:10.1109/9.256330.
    """
    W = _weight(even, g, shape)
    law = central_law(series(even.plant, W), margin)
    return None if law is None else series(W, law)


def _weight(even: EvenPlant, g: float, shape: StateSpace) -> StateSpace:
    one = series(shape, gain([[g]], even.plant.rate_hz))
    return append(*[one] * even.plant.D.shape[0])


def band_shape(
    band_hz: tuple[float, float] | None,
    tones_hz: tuple[float, ...],
    tone_height: float,
    tone_zeta: float,
    rate_hz: float | None,
    order: int | None = None,
) -> StateSpace:
    """Return a weight of one channel: one over a band, a tenth outside it, with peaks at tones; flat without band."""
    if band_hz is None:
        shape = gain([[1.0]], rate_hz)
    else:
        low, high = band_hz[0] / WIDER, band_hz[1] * WIDER
        if rate_hz is not None:
            high = min(high, max(HIGHEST * rate_hz, (low + rate_hz / 2) / 2))
        shape = band_pass((low, high), 1.0, FLOOR, order or EDGES, rate_hz)
    return with_tones(shape, tones_hz, tone_height, tone_zeta)


def absolute_shape(
    plant: StateSpace, band_hz: tuple[float, float] | None, height: float, floor: float, order: int
) -> StateSpace:
    """Return a weight of one channel, `height` over a band and `floor` outside it; the plant's own band when absent.

    A plant that is loud from rest on has a band without a lower edge, and so has the weight: an edge at the lowest
    frequency that somebody looked at would put its poles there, a million times slower than all others.
    """
    if band_hz is not None:
        return band_pass(band_hz, height, floor, order, plant.rate_hz)
    even = even_plant(plant)
    if even.from_rest:
        return low_pass(even.band_hz[1], height, floor, max(order // 2, 1), plant.rate_hz)
    return band_pass(even.band_hz, height, floor, order, plant.rate_hz)
