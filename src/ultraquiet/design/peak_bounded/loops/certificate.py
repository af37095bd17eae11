"""What a law reaches on a plant between the lines of its search: a fine grid that holds the loop's modes, refined."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.peaks import refined
from ultraquiet.design.law_structure.controller_structure import ControllerStructure
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.loops.largest import LEAST
from ultraquiet.design.peak_bounded.loops.parts import LoopParts
from ultraquiet.design.peak_bounded.loops.scenario import Scenario

LINES, DECADES, CONTINUOUS_HZ = 1500, 5.0, 1e4
WIDTHS = np.array([-1.0, -0.3, 0.0, 0.3, 1.0])  # of a mode of the loop: lines about it
SLOWER = np.array([0.1, 0.3, 1.0, 3.0])  # times a pole of the loop: lines about one slower than the grid begins
ROUNDS = 5  # of narrowing a peak, each to a quarter: a smooth top is then known to 1e-5 dB


class Certified(NamedTuple):
    """Worst direction of the band and largest amplification, dB; greatest excess over a bound, dB, and where, Hz."""

    attenuation_db: float
    peak_db: float
    excess_db: float
    excess_hz: float


Grid = tuple[FloatArray, LoopParts]
Part = Callable[[LoopParts, FloatArray], FloatArray]

UNSTABLE = Certified(-np.inf, np.inf, np.inf, float("nan"))


class LoopCertificate:
    """A plant on the fine grid, to judge one law after the other.

    Args:
        scenario: the plant.
        demands: whose bounds count, those on S, on K S and on the margins at both ends.
    """

    def __init__(self, scenario: Scenario, demands: Demands) -> None:
        self.scenario, self.demands = scenario, demands
        plane, rate_hz = scenario.plane, scenario.plant.rate_hz
        top = CONTINUOUS_HZ if rate_hz is None else rate_hz / 2
        f = np.geomspace(top / 10**DECADES, top * 0.9999, LINES)
        self._w = np.unique(np.concatenate([plane.of_hz(f), scenario.w]))
        self._G = scenario.response(plane.hz(self._w))

    def of(self, law: ControllerStructure, theta: FloatArray) -> Certified:
        """Return what a law reaches; it is `UNSTABLE` where the loop is."""
        grid = self._closed(law, theta)
        if grid is None:
            return UNSTABLE
        f, loop = grid
        excess, at_hz = self._excess(law, theta, grid)

        def quiet(each: LoopParts, lines: FloatArray) -> FloatArray:
            return _sizes(each.S @ self.scenario.directions(each.G))

        def amplified(each: LoopParts, lines: FloatArray) -> FloatArray:
            return _sizes(each.S)

        inside = np.flatnonzero(self.demands.inside(f))
        level = self._largest(law, theta, quiet, f[inside], quiet(loop.at(inside), f[inside]))[0]
        peak = self._largest(law, theta, amplified, f, amplified(loop, f))[0]
        return Certified(-level, peak, excess, at_hz)

    def excess(self, law: ControllerStructure, theta: FloatArray) -> tuple[float, float]:
        """Return the greatest excess over a bound, dB, and where, Hz; infinite where the loop is unstable."""
        grid = self._closed(law, theta)
        return (np.inf, float("nan")) if grid is None else self._excess(law, theta, grid)

    def exceeded_hz(self, law: ControllerStructure, theta: FloatArray, least_db: float) -> FloatArray:
        """Return every place, Hz, where a bound is exceeded by more than `least_db`; none where the loop is unstable.

        The tops on the fine grid, and the greatest of all as it is between its lines: whoever mends the greatest alone
        finds the next one in its stead.
        """
        grid = self._closed(law, theta)
        if grid is None:
            return np.zeros(0)
        f, loop = grid
        shares = [(part, part(loop, f)) for part in self._bounded(f)]
        places = [_tops(f, 20 * np.log10(np.maximum(sizes, LEAST)), least_db) for _, sizes in shares]
        greatest, at_hz = max(self._largest(law, theta, part, f, sizes) for part, sizes in shares)
        return np.unique(np.concatenate([*places, [at_hz] if greatest > least_db else []]))

    def _excess(self, law: ControllerStructure, theta: FloatArray, grid: Grid) -> tuple[float, float]:
        f, loop = grid
        return max(self._largest(law, theta, part, f, part(loop, f)) for part in self._bounded(f))

    def _bounded(self, f: FloatArray) -> list[Part]:
        """Return sigma(S), sigma(K S) and, at the ends where it is bounded, sigma(S - I/2) over their bounds."""
        demands = self.demands

        def amplified(each: LoopParts, lines: FloatArray) -> FloatArray:
            return _sizes(each.S) / _gain(demands.sensitivity_db(lines))

        def driven(each: LoopParts, lines: FloatArray) -> FloatArray:
            return _sizes(each.control) / _gain(demands.control_db(lines))

        def off(end: str) -> Part:
            return lambda each, lines: _sizes(each.half_off(end)) * demands.disk_margin

        return [amplified, driven, *(off(end) for end in demands.margin_ends(f))]

    def _largest(
        self, law: ControllerStructure, theta: FloatArray, part: Part, f: FloatArray, sizes: FloatArray
    ) -> tuple[float, float]:
        """Return the largest value of a part of the loop, of these sizes at lines f, there and between; dB, where."""

        def between(lines: FloatArray) -> FloatArray:
            return part(self._loop(law, theta, self.scenario.response(lines), self.scenario.plane.of_hz(lines)), lines)

        size, at_hz = refined(between, f, sizes, rounds=ROUNDS)
        return 20 * float(np.log10(max(size, LEAST))), at_hz

    def _closed(self, law: ControllerStructure, theta: FloatArray) -> Grid | None:
        """Return the lines in Hz and the loop there; None where it is unstable."""
        poles = self.scenario.poles(law.system(theta))
        if np.any(poles.real >= 0):
            return None
        w, G = self._lines(poles)
        return self.scenario.plane.hz(w), self._loop(law, theta, G, w)

    @staticmethod
    def _loop(law: ControllerStructure, theta: FloatArray, G: ComplexArray, w: FloatArray) -> LoopParts:
        return LoopParts.of(G, law.response(theta, (1j * w).astype(np.complex128)))

    def _lines(self, poles: ComplexArray) -> tuple[FloatArray, ComplexArray]:
        """Return the grid with lines about the loop's modes and down to its slowest pole, and G there.

        Below the slowest pole of the loop S only falls, if it is not level, so that no peak is left below the grid.
        """
        modes, size = poles[poles.imag > 0], np.abs(poles)
        own = np.concatenate(
            [
                (modes.imag[:, None] + np.abs(modes.real)[:, None] * WIDTHS).ravel(),
                (size[size < self._w[0] / SLOWER[0], None] * SLOWER).ravel(),
            ]
        )
        own = own[(own > 0) & (own < self._w[-1])]
        w = np.concatenate([self._w, own])
        order = np.argsort(w, kind="stable")
        return w[order], np.concatenate([self._G, self.scenario.response(self.scenario.plane.hz(own))])[order]


def _tops(f_hz: FloatArray, level_db: FloatArray, least_db: float) -> FloatArray:
    """Return where levels have a local maximum above one of them."""
    padded = np.concatenate([[-np.inf], level_db, [-np.inf]])
    return f_hz[(level_db > least_db) & (level_db >= padded[:-2]) & (level_db >= padded[2:])]


def _sizes(M: ComplexArray) -> FloatArray:
    return np.asarray(np.linalg.norm(M, 2, axis=(1, 2)), dtype=np.float64)


def _gain(level_db: FloatArray) -> FloatArray:
    return np.asarray(10 ** (level_db / 20), dtype=np.float64)
