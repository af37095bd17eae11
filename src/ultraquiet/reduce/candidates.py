"""Small controllers that might do for a large one: projected from Gramians of the loop, tuned on a grid, compared."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.linalg import balance
from ultraquiet.linalg.modal_response import residues
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.reduce._abstract import METHODS, joined, project, split
from ultraquiet.reduce.certificate import loop_norm
from ultraquiet.reduce.grid import grid_of
from ultraquiet.reduce.stepwise import in_steps, loop_gramians, mean_block
from ultraquiet.reduce.tuning import Descent, LawSizes, matrices, packed
from ultraquiet.reduce.weighting import output_gramian
from ultraquiet.values.interconnect import lft, of_one_channel, repeated
from ultraquiet.values.state_space import StateSpace

# Exponents of the smooth peak, one descent after the other: the first sees the whole band, the last the peak alone.
POWERS = (8, 32, 100, 100, 100, 200, 200, 200)


class ReducedLaw(NamedTuple):
    """A reduced controller, the values by which states were kept, its cost over the full one's, and how it was made."""

    system: StateSpace
    hankel: FloatArray
    cost: float
    way: str


class _Source(NamedTuple):
    """A part of the controller with its Gramians, and the part that is kept beside it."""

    name: str
    M: Matrices
    P: FloatArray
    Q: FloatArray
    kept: tuple[FloatArray, FloatArray, FloatArray]


class Candidates:
    """All that a reduction by the closed loop needs to know of the loop, computed once.

    Raises:
        InputError: the loop with the full controller is not stable.
    """

    def __init__(self, P: StateSpace, K: StateSpace, method: str, norm: str) -> None:
        self.P, self._K, self._norm = P, K, norm
        loop = lft(P, K)
        self._discrete = P.rate_hz is not None
        # a direct term that was not there makes a continuous mean square infinite
        truncation_only = norm == "mean-square" and not self._discrete
        self._ways = ("truncation",) if truncation_only else tuple(dict.fromkeys((method, "truncation")))
        if not loop.is_stable():
            raise InputError("ClosedLoopWeighted: the loop with the full controller is unstable; nothing can be kept.")
        self.before = loop_norm(loop, norm)
        if not np.isfinite(self.before):
            raise InputError("ClosedLoopWeighted: the mean square of this loop is infinite; take norm='peak'.")
        self._law, self._copies = of_one_channel(K)
        self._sources = self._gramians(loop)
        self._grid = grid_of(P, K, loop.poles())
        self._full = self._grid.norm(self._grid.K, norm)

    @property
    def channels(self) -> tuple[int, int]:
        """Outputs and inputs of the plant."""
        nu, ny = self._K.D.shape
        return ny, nu

    def projected(self, count: int) -> ReducedLaw:
        """Return the best projection to `count` states."""
        if count >= self._K.states:
            return ReducedLaw(self._K, np.zeros(0), 1.0, "whole")
        tries = self._projections(count)
        if not tries:
            raise NumericalError(f"ClosedLoopWeighted: no projection to {count} states could be formed; keep more.")
        return min(tries, key=lambda t: t.cost)

    def in_steps(self, count: int) -> ReducedLaw:
        """Return the law of `count` states that a few less at a time lead to; at an infinite cost where they do not."""
        methods = [method for method in METHODS if method in self._ways]
        try:
            found = in_steps(self.P, self._law, self._copies, count // self._copies, methods)
        except (np.linalg.LinAlgError, NumericalError):
            found = None
        if found is None:
            return ReducedLaw(self._K, np.zeros(0), np.inf, "none")
        law, hankel = found
        return self._seen((law.A, law.B, law.C, law.D), hankel, "loop, in steps")

    def tuned(self, count: int, steps: int, allowed: float) -> ReducedLaw:
        """Return the best controller of `count` states after descents from projections; stops when good enough."""
        order = count // self._copies
        shape = LawSizes(order, self._law.D.shape[0], self._law.D.shape[1], self._copies)
        descent = Descent(self._grid, shape, self._norm, self._discrete)
        tried = []
        for start in self._projections(count):
            ended = self._first_descents(descent, shape, start, steps)
            if ended is not None:
                tried.append(ended)
                if ended[0].cost <= 1 + allowed:
                    return ended[0]
        if not tried:
            return ReducedLaw(self._K, np.zeros(0), np.inf, "none")
        best, x = min(tried, key=lambda t: t[0].cost)
        for power in POWERS[1:] if self._norm == "peak" else ():
            if best.cost <= 1 + allowed:
                break
            x = descent.on_loop(x, steps, power)
            best = min(best, self._seen(matrices(x, shape), best.hankel, best.way), key=lambda c: c.cost)
        return best

    def _first_descents(
        self, descent: Descent, shape: LawSizes, start: ReducedLaw, steps: int
    ) -> tuple[ReducedLaw, FloatArray] | None:
        """Move towards the full controller, then down on the loop's norm; None where the loop stays unstable."""
        one = of_one_channel(start.system)[0] if self._copies > 1 else start.system
        x = packed((one.A, one.B, one.C, one.D), shape, self._discrete) if one.states == shape.states else None
        if x is None:
            return None
        x, way = descent.towards_full(x, steps // 2), f"{start.way}, tuned"
        near = self._seen(matrices(x, shape), start.hankel, way)
        if not np.isfinite(near.cost):
            return None
        x = descent.on_loop(x, steps, POWERS[0])
        return min(near, self._seen(matrices(x, shape), start.hankel, way), key=lambda c: c.cost), x

    def _projections(self, count: int) -> list[ReducedLaw]:
        tries = [c for source in self._sources for c in self._from(source, count)]
        if self._copies == 1 and not any(np.isfinite(t.cost) for t in tries):
            # two-sided weights do not promise a stable law; plain balancing does
            tries += self._from_plain(count)
        return tries

    def _from_plain(self, count: int) -> list[ReducedLaw]:
        """Return the projections by the law's own Gramians."""
        try:
            stable, kept, _ = split(self._K)
            P, Q = balance.gramians(*stable[:3], self._discrete)
        except NumericalError:
            return []
        return self._from(_Source("plain", stable, P, Q, kept), count)

    def _from(self, source: _Source, count: int) -> list[ReducedLaw]:
        """Return the projections by one pair of Gramians."""
        tries, keep = [], count // self._copies - source.kept[0].shape[0]
        if not 0 <= keep <= source.M[0].shape[0]:
            return []
        for way in self._ways:
            try:
                M, hankel = project(source.M, source.P, source.Q, keep, self._discrete, way)
            except (np.linalg.LinAlgError, NumericalError):
                continue
            tries.append(self._seen(joined(M, source.kept), hankel, f"{source.name}, {way}"))
        return tries

    def _seen(self, M: Matrices, hankel: FloatArray, way: str) -> ReducedLaw:
        """Judge a controller on the grid, and by the poles of its loop."""
        small = repeated(StateSpace(*M, rate_hz=self._K.rate_hz), self._copies)
        try:
            kept = lft(self.P, small).is_stable()
        except InputError:
            kept = False
        if not kept:
            return ReducedLaw(small, hankel, np.inf, way)
        seen = np.moveaxis(residues(small.A, small.B, small.C, small.D).at(self._grid.points), 2, 0)
        cost = self._grid.norm(seen, self._norm) / self._full if self._full else 1.0
        return ReducedLaw(small, hankel, cost, way)

    def _gramians(self, loop: StateSpace) -> list[_Source]:
        """Return Gramians of K's state inside the loop, and those of Enns's cascade for the stable part of K.

        Both are controlled in one way: a state of K has the same covariance in the loop as behind (I - P22 K)^-1 P21.
        """
        K, copies = self._law, self._copies
        Pc, Qo = loop_gramians(self.P, loop, copies)
        M: Matrices = (K.A, K.B, K.C, K.D)
        sources = [_Source("loop", M, Pc, Qo, _nothing(K))]
        cascade = self._cascade(Pc)
        return sources if cascade is None else [*sources, cascade]

    def _cascade(self, Pc: FloatArray) -> _Source | None:
        """Return Gramians of the cascade; None where they have no limit."""
        K, copies = self._K, self._copies
        after = _influence(self.P, K)
        try:
            if copies == 1:
                stable, kept, rows = split(K)
                Q = output_gramian(stable, after, self._discrete)
                return _Source("cascade", stable, rows @ Pc @ rows.T, Q, kept)
            if not K.is_stable():
                return None
            Q = output_gramian((K.A, K.B, K.C, K.D), after, self._discrete)
        except NumericalError:
            return None
        law = self._law
        M: Matrices = (law.A, law.B, law.C, law.D)
        return _Source("cascade", M, Pc, mean_block(Q, copies), _nothing(law))


def _nothing(law: StateSpace) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the part beside a law that is reduced as a whole."""
    return np.zeros((0, 0)), np.zeros((0, law.D.shape[1])), np.zeros((law.D.shape[0], 0))


def _influence(P: StateSpace, K: StateSpace) -> Matrices:
    """Return P12 (I - K P22)^-1, what stands behind a change of K."""
    m = P.D.shape[1] - K.D.shape[0]
    B2, D12 = P.B[:, m:], P.D[:, m:]
    felt = lft(StateSpace(P.A, np.hstack([B2, B2]), P.C, np.hstack([D12, D12]), P.rate_hz), K)
    return felt.A, felt.B, felt.C, felt.D
