"""How a law stands against its demands on several plants: levels in dB, and their slopes after the law's parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.law_structure.controller_structure import ControllerStructure
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.loops.largest import largest_within, upper_db
from ultraquiet.design.peak_bounded.loops.parts import LoopParts
from ultraquiet.design.peak_bounded.loops.scenario import Scenario
from ultraquiet.design.peak_bounded.step import DB, LEAST, Linearised

TIGHT_DB = 0.03  # bounds are put so much tighter than meant, for what stands between the lines
# A response so far below the plant's largest is not lowered further, as that of an integrator might be for ever.
ENOUGH_DB = 60.0
WIDER = 6.0  # gains that are linearised as complex numbers enter from so many times further below their bounds


@dataclass(frozen=True, eq=False)
class DemandFamily:
    """One kind of demand on one plant: sigma(M) in dB less a bound at some lines.

    Attributes:
        loop: of which M is a part.
        lines: of the loop, one for each M.
        M: `(lines, rows, columns)`.
        right: of dM = left dK right, at the same lines; left is S G, or (I - K G)^-1 where M are commands.
        bound_db: for each line.
        sought: the greatest level is to be lowered.
        linear: in the law's parameters, as K S is where the loop's gain is small.
        commands: M are commands and not readings.
    """

    loop: LoopParts
    lines: np.ndarray
    M: ComplexArray
    right: ComplexArray
    bound_db: FloatArray
    sought: bool = False
    linear: bool = False
    commands: bool = False

    def sides(self, line: np.ndarray) -> tuple[ComplexArray, ComplexArray]:
        """Return left and right of dM = left dK right at some of its lines."""
        loop = self.loop.at(self.lines[line])
        return loop.at_input if self.commands else loop.S @ loop.G, self.right[line]


class Pick(NamedTuple):
    """Some singular values of a family: at which of its lines, and which one there."""

    line: np.ndarray
    which: np.ndarray


@dataclass(frozen=True)
class Standing:
    """The greatest level that is sought and the greatest excess over a bound, dB."""

    level_db: float
    excess_db: float


class LoopLevels:
    """A structure of the law, demands, and plants on which they count.

    Args:
        structure: of the law.
        demands: on every plant.
        scenarios: the plants.
    """

    def __init__(self, structure: ControllerStructure, demands: Demands, scenarios: Sequence[Scenario]) -> None:
        self.structure, self.demands, self.scenarios = structure, demands, tuple(scenarios)

    def standing(self, theta: FloatArray) -> Standing:
        """Return how the law stands on all plants; infinite where a loop is singular at a line."""
        level, excess = -np.inf, -np.inf
        try:
            for scenario in self.scenarios:
                for family in self._families(theta, scenario):
                    top = _top(family)
                    level, excess = (max(level, top), excess) if family.sought else (level, max(excess, top))
        except np.linalg.LinAlgError:
            return Standing(np.inf, np.inf)
        return Standing(level if self.demands.response_db is None else max(level, -ENOUGH_DB), excess)

    def linearised(self, theta: FloatArray, width_db: float, most: int) -> tuple[Linearised, list[Pick]]:
        """Return every singular value within `width_db` of the greatest of its kind, or of its bound, with its slope.

        Of neighbouring lines that are as near some are left out where there are more than `most` a plant; the local
        maxima never are. Also returned is which ones they are, for `again`.
        """
        tops, n = self.standing(theta), theta.size
        values, slopes, sought = [np.zeros(0)], [np.zeros((0, n))], [np.zeros(0, dtype=bool)]
        gains, turns = [np.zeros(0)], [np.zeros((0, n), dtype=np.complex128)]
        picks: list[Pick] = []
        for scenario in self.scenarios:
            for family in self._families(theta, scenario):
                top = tops.level_db if family.sought else max(tops.excess_db, 0.0)
                pick = _near(family, top - (WIDER * width_db if family.linear else width_db), most)
                picks.append(pick)
                if not pick.line.size:
                    continue
                value, slope = self._slopes(theta, scenario, family, pick)
                if family.linear:
                    gains.append(np.exp(value / DB))
                    turns.append(slope * gains[-1][:, None])
                else:
                    values.append(value)
                    slopes.append(DB * slope.real)
                    sought.append(np.full(value.size, family.sought))
        model = Linearised(
            np.concatenate(values),
            np.concatenate(slopes),
            np.concatenate(sought),
            np.concatenate(gains),
            np.concatenate(turns),
            np.minimum(self.structure.lowest - theta, 0.0),
        )
        return model, picks

    def again(self, theta: FloatArray, picks: Sequence[Pick]) -> tuple[FloatArray, FloatArray]:
        """Return the levels and the gains of the same singular values at other parameters."""
        values, gains, left = [np.zeros(0)], [np.zeros(0)], iter(picks)
        for scenario in self.scenarios:
            for family in self._families(theta, scenario):
                pick = next(left)
                lines, back = np.unique(pick.line, return_inverse=True)
                if not lines.size:
                    continue
                sigma = np.linalg.svd(family.M[lines], compute_uv=False)[back, pick.which]
                level = DB * np.log(np.maximum(sigma, LEAST)) - family.bound_db[pick.line]
                (gains if family.linear else values).append(np.exp(level / DB) if family.linear else level)
        return np.concatenate(values), np.concatenate(gains)

    def _slopes(
        self, theta: FloatArray, scenario: Scenario, family: DemandFamily, pick: Pick
    ) -> tuple[FloatArray, ComplexArray]:
        """Return levels in dB and complex relative slopes."""
        lines, line = np.unique(pick.line, return_inverse=True)
        which = pick.which
        U, sigma, Vh = np.linalg.svd(family.M[lines], full_matrices=False)
        size = np.maximum(sigma[line, which], LEAST)[:, None]
        before, after = family.sides(lines)
        left = np.einsum("ki,kij->kj", U[line, :, which].conj(), before[line]) / size
        right = np.einsum("kij,kj->ki", after[line], Vh[line, which].conj())
        s = (1j * scenario.w[family.lines[pick.line]]).astype(np.complex128)
        levels = DB * np.log(size[:, 0]) - family.bound_db[pick.line]
        return levels, self.structure.gradient(theta, s, left, right)

    def _families(self, theta: FloatArray, scenario: Scenario) -> list[DemandFamily]:
        """Return the demands on one plant with its closed-loop responses."""
        demands, f = self.demands, scenario.f_hz
        outputs = scenario.plant.D.shape[0]
        loop = LoopParts.of(scenario.G, self.structure.response(theta, (1j * scenario.w).astype(np.complex128)))
        G, _, S = loop
        band = np.flatnonzero(demands.inside(f))
        every = np.arange(f.size)
        reached = scenario.reached if demands.response_db is None else G
        quiet: ComplexArray = S[band] @ reached[band]
        out = [
            DemandFamily(loop, band, quiet, quiet, np.full(band.size, demands.response_db or 0.0), sought=True),
            DemandFamily(loop, every, S, S, demands.sensitivity_db(f) - TIGHT_DB),
            DemandFamily(loop, every, loop.control, S, demands.control_db(f) - TIGHT_DB, linear=True, commands=True),
        ]
        for end in demands.margin_ends(f):
            inner = end == "input"
            bound_db = np.full(f.size, demands.margin_db - TIGHT_DB)
            out.append(DemandFamily(loop, every, loop.half_off(end), S @ G if inner else S, bound_db, commands=inner))
        if demands.complementary_db is not None:
            out.append(DemandFamily(loop, every, S - np.eye(outputs), S, demands.complementary_db(f), linear=True))
        if demands.tones_hz:
            w = scenario.plane.of_hz(np.array(demands.tones_hz))
            at = np.array([int(np.argmin(np.abs(scenario.w - each))) for each in w])
            tones: ComplexArray = S[at] @ np.linalg.svd(G[at], full_matrices=False)[0].astype(np.complex128)
            out.append(DemandFamily(loop, at, tones, tones, np.full(at.size, -demands.tone_db)))
        return out


def _top(family: DemandFamily) -> float:
    """Return the greatest level of a family."""
    return largest_within(family.M, family.bound_db)


def _near(family: DemandFamily, least_db: float, most: int) -> Pick:
    """Return the singular values above a level."""
    first = np.flatnonzero(upper_db(family.M) - family.bound_db >= least_db)
    sigma = np.linalg.svd(family.M[first], compute_uv=False)
    levels = DB * np.log(np.maximum(sigma, LEAST)) - family.bound_db[first, None]
    line, which = np.nonzero(_chosen(levels, least_db, most))
    return Pick(first[line], which)


def _chosen(levels: FloatArray, least_db: float, most: int) -> np.ndarray:
    """Return which levels `(line, singular value)` count: local maxima over lines, the highest, some of the rest."""
    above = levels >= least_db
    padded = np.pad(levels, ((1, 1), (0, 0)), constant_values=-np.inf)
    tops = above & (levels >= padded[:-2]) & (levels >= padded[2:])
    others = np.flatnonzero((above & ~tops).ravel())
    others = others[np.argsort(-levels.ravel()[others], kind="stable")]
    high, low = others[: most // 2], others[most // 2 :]
    every = max(1, -(-low.size // max(most // 2, 1)))
    chosen = tops.ravel().copy()
    chosen[high] = True
    chosen[low[::every]] = True
    return chosen.reshape(levels.shape)
