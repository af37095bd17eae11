"""Whether a loop keeps a disk margin at both ends of its plant, with no more work than the answer takes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.disk import ENDS, disk_margin
from ultraquiet.analyse.loop_response import both_sensitivities
from ultraquiet.analyse.margins import default_grid, even_loop
from ultraquiet.analyse.scalings.upper import upper_bound
from ultraquiet.analyse.structure import structure
from ultraquiet.linalg.norms import largest_gains
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace

CLEARLY = 1.1  # times the margin, on the lines of a grid: peaks between them are lower than that
SPARSE = 10  # of the lines of a grid, one of so many is looked at before the others
FEW = 16  # lines at a time that are bounded closely


def margin_kept(plant: StateSpace, law: StateSpace, enough: float) -> bool:
    """Return whether the disk margins at both ends are at least `enough`, which they need not be known for.

    A few lines of a grid mostly show mu beyond its limit, and the norm on all of them that it is clearly below. Only
    where neither does is its peak sought.
    """
    loop = _StableLoop.of(plant, law)
    if loop is None or enough <= 0:
        return loop is not None
    clearly, most = 1 / (CLEARLY * enough), 1 / enough
    looked = loop.looked(clearly, most)
    if any(lines.largest > most for lines in looked):
        return False
    open_ends = [side for side, lines in zip(ENDS, looked, strict=True) if lines.norm > clearly]
    return all(disk_margin(plant, law, side) >= enough for side in open_ends)


def surely_less(plant: StateSpace, law: StateSpace, enough: float) -> bool:
    """Return whether a loop is stable and its disk margin at an end below `enough`, as far as a few lines show it."""
    loop = _StableLoop.of(plant, law)
    if loop is None or enough <= 0:
        return False
    return any(lines.largest > 1 / enough for lines in loop.looked(1 / enough, 1 / enough))


def about_kept(plant: StateSpace, law: StateSpace, asked: float) -> float:
    """Return the smaller of the disk margins at both ends; where that is below `asked`, a number not below it.

    Lines at which one channel, or all alike, already need less are found first: eigenvalues cost less than mu.
    """
    loop = _StableLoop.of(plant, law)
    if loop is None:
        return 0.0
    most = np.inf
    for X in loop.off_half(loop.f_hz):
        largest = max(np.abs(np.linalg.eigvals(X)).max(initial=0.0), np.abs(np.einsum("fii->fi", X)).max(initial=0.0))
        most = min(most, 1 / float(largest))
    return most if most < asked else min(disk_margin(plant, law, side) for side in ENDS)


class _Lines(NamedTuple):
    """The largest norm of S - 1/2 on lines of a grid, and mu of the lines where norms are highest."""

    norm: float
    largest: float


class _StableLoop(NamedTuple):
    """The grid of a stable loop, Hz, and what gives S at the plant's input and output on lines of it."""

    f_hz: FloatArray
    sensitivities: Callable[[FloatArray], tuple[ComplexArray, ComplexArray]]

    @classmethod
    def of(cls, plant: StateSpace, law: StateSpace) -> "_StableLoop | None":
        """Return the loop, None where it is not stable.

        Its poles say so and give the grid; its response is formed from those of plant and law, whose modes are far
        fewer and mostly apart where those of the loop are not.
        """
        G, K = even_loop(plant, law)
        try:
            S = sensitivity(G, K)
        except InputError:  # not well posed
            return None
        return cls(default_grid(S), both_sensitivities(G, K)) if S.is_stable() else None

    def off_half(self, f_hz: FloatArray) -> list[ComplexArray]:
        """Return S - 1/2 at both ends, `(lines, channels, channels)`."""
        return [S - np.eye(S.shape[1]) / 2 for S in self.sensitivities(f_hz)]

    def looked(self, clearly: float, most: float) -> list[_Lines]:
        """Return both ends on the lines of the grid, or on one in a few where those hold a mu above `most`.

        The norm is a bound of mu that costs little, and the lines where it is highest mostly decide alone. They are
        bounded closely where it leaves open whether mu is above `clearly`, which stands for all below it.
        """
        sparse = [_on(X, clearly, most) for X in self.off_half(self.f_hz[::SPARSE])]
        if any(lines.largest > most for lines in sparse):
            return sparse
        return [_on(X, clearly, clearly) for X in self.off_half(self.f_hz)]


def _on(X: ComplexArray, clearly: float, limit: float) -> _Lines:
    norms = largest_gains(X)
    largest = _closely(X[np.argsort(-norms)[:FEW]], clearly) if norms.max() > limit else 0.0
    return _Lines(float(norms.max()), max(largest, clearly))


def _closely(X: ComplexArray, least: float) -> float:
    """Return the largest bound of mu over some lines, for one complex number a channel; below `least` not closely."""
    return float(upper_bound(X, structure("margin_kept", None, X.shape[1:]), least).value.max())
