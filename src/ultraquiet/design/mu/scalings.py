"""Scalings of mu's upper bound as filters: one stable minimum-phase function a block, small and near enough."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.mu import MuBounds
from ultraquiet.design.weights.filters import realised
from ultraquiet.linalg.magnitude_fit import fit_near
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace

# A scaling may be off where mu is below this share of its peak, but not by anything. High enough, or the K-step would
# be given scalings that suit one frequency only.
LOOSE = 0.3
WORTH = 1.01  # a larger order must lower the excess by more than this factor


@dataclass(frozen=True, eq=False)
class Scaling:
    """Filters of the blocks, one each and its inverse, and how far the scaled loop lies above mu at worst."""

    blocks: tuple[tuple[int, int], ...]
    left: tuple[StateSpace, ...]
    right: tuple[StateSpace, ...]
    order: int
    excess: float


def constant(blocks: tuple[tuple[int, int], ...], size: float, rate_hz: float | None) -> Scaling:
    """Return one number for every block but the last, whose scaling is one."""
    sizes = [*[size] * (len(blocks) - 1), 1.0]
    left, right = (tuple(gain([[x]], rate_hz) for x in side) for side in (sizes, [1 / x for x in sizes]))
    return Scaling(blocks, left, right, 0, np.inf)


def fitted(
    tried: list[Scaling], M: ComplexArray, bounds: MuBounds, rate_hz: float | None, used: Scaling, push: float
) -> Scaling:
    """Return the smallest scaling within a percent of the best of those of every order.

    Args:
        tried: `fitted_of_every_order` of the same loop.
        M: response of the loop `(nz, nw, nf)` on the lines of the bounds.
        bounds: of mu there; the last block's scaling is one.
        rate_hz: of the design.
        used: the scaling that the loop was designed with.
        push: how much further than to the bound's scaling to go from the one used, as a share of the way; near their
            end, iterations without it creep.
    """
    best = min(s.excess for s in tried)
    chosen = next(s for s in tried if s.excess <= WORTH * best)
    if push == 0:
        return chosen
    before = np.array([np.abs(s.frequency_response(bounds.f_hz)[0, 0]) for s in used.left])
    further = bounds.levels * (bounds.levels / before) ** push
    return _of_order(M, further, bounds, chosen.order, rate_hz)


def fitted_of_every_order(M: ComplexArray, bounds: MuBounds, highest: int, rate_hz: float | None) -> list[Scaling]:
    """Return the scaling that fits the bound's best with filters of each order up to `highest`, constants first."""
    return [_of_order(M, bounds.levels, bounds, order, rate_hz) for order in range(highest + 1)]


def scaled(P: StateSpace, scaling: Scaling, measurements: int, controls: int) -> StateSpace:
    """Return D P D^-1, measurements and controls left as they are."""
    sides = []
    for filters, side, wires in ((scaling.right, 1, controls), (scaling.left, 0, measurements)):
        copies = [f for f, block in zip(filters, scaling.blocks, strict=True) for _ in range(block[side])]
        sides.append(append(*copies, gain(np.eye(wires), P.rate_hz)))
    return series(series(sides[0], P), sides[1])


def _of_order(
    M: ComplexArray,
    levels: FloatArray,
    bounds: MuBounds,
    order: int,
    rate_hz: float | None,
) -> Scaling:
    weight = np.maximum(bounds.upper / bounds.upper.max(), LOOSE)
    blocks = tuple((b.outputs, b.inputs) for b in bounds.blocks)
    left, right = [], []
    for level in levels:
        flat = np.ptp(np.log(level)) == 0
        one, inverse = _filters(bounds.f_hz, level, 0 if flat else order, weight, rate_hz)
        left.append(one)
        right.append(inverse)
    sizes = [
        np.repeat([np.abs(s.frequency_response(bounds.f_hz)[0, 0]) for s in side], [b[k] for b in blocks], axis=0)
        for k, side in ((0, left), (1, right))
    ]
    stack = np.moveaxis(sizes[0][:, None] * M * sizes[1][None], 2, 0)
    over = np.linalg.norm(stack, 2, axis=(1, 2)) / (weight * bounds.upper.max())
    return Scaling(blocks, tuple(left), tuple(right), order, float(over.max()))


def _filters(
    f_hz: FloatArray, level: FloatArray, order: int, weight: FloatArray, rate_hz: float | None
) -> tuple[StateSpace, StateSpace]:
    unit = float(np.exp(np.mean(np.log(f_hz[f_hz > 0][[0, -1]]))))
    if rate_hz is None:
        x = f_hz / unit
    else:  # Tustin's rule bends the axis; what is fitted over the bent one is exact in discrete time
        unit = min(unit, rate_hz / 8)
        x = np.tan(np.pi * np.minimum(f_hz / rate_hz, 0.4999)) / np.tan(np.pi * unit / rate_hz)
    W = fit_near(x, level, order, weight)
    return (
        realised(W.zeros, W.poles, W.gain, unit, rate_hz, 1),
        realised(W.poles, W.zeros, 1 / W.gain, unit, rate_hz, 1),
    )
