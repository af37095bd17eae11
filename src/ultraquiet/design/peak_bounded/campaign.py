"""A search from several starts: on the plants given first, then with those drawn near them."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.progress import Task, task
from ultraquiet.design.fixed_structure.controller_structure import ControllerStructure
from ultraquiet.design.fixed_structure.plane import plane_of
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.levels import LoopLevels
from ultraquiet.design.peak_bounded.outcome import exceeded
from ultraquiet.design.peak_bounded.scenario import Scenario
from ultraquiet.design.peak_bounded.search import PRICE, SearchEnd, calmed, search
from ultraquiet.design.peak_bounded.step import merit
from ultraquiet.values.state_space import StateSpace

LINES_A_DECADE = 40
DECADES = 2.0  # below the band; above it the grid goes to Nyquist, or as far
LOOKS = 8  # steps from each start before the best goes on
ROUNDS, HIDDEN_DB = 3, 0.01  # of looks between the lines, and what counts as a bound exceeded there
FAN = np.array([0.995, 1.0, 1.005])  # lines around such a place

Start = tuple[ControllerStructure, FloatArray]


class Campaign:
    """Demands, plants in the units of the search, and how long to search.

    Args:
        demands: on every plant.
        plants: those given.
        near: those drawn near them.
        steps: on the plants given, and again with all, at most.
        roof_hz: a line that the grid must hold.
    """

    def __init__(
        self, demands: Demands, plants: Sequence[StateSpace], near: Sequence[StateSpace], steps: int, roof_hz: float
    ) -> None:
        self.demands, self.plants, self.near, self.steps = demands, tuple(plants), tuple(near), steps
        self.plane = plane_of(self.plants[0])
        self.taken, self.lines = 0, 0
        self._f = _grid(demands, self.plants[0].rate_hz, roof_hz)

    def best(self, starts: Sequence[Start]) -> StateSpace | None:
        """Return the law that a search from the best of several starts ends with; None where none is stable."""
        given = self._scenarios(self.plants)
        with task("peak-bounded search", LOOKS * len(starts) + 2 * self.steps) as progress:
            looks = [end for start in starts if (end := self._searched(*start, given, LOOKS, progress)) is not None]
            if not looks:
                return None
            law, end = min(looks, key=lambda each: merit(each[1].standing.level_db, each[1].standing.excess_db, PRICE))
            every = [*given, *self._scenarios(self.near)]
            end = self._searched(law, end.theta, given, self.steps, progress)
            if end is not None and self.near:
                end = self._searched(law, end[1].theta, every, self.steps, progress)
            for _ in range(ROUNDS):
                if end is None or not self._hidden(law, end[1].theta, every):
                    break
                end = self._searched(law, end[1].theta, every, LOOKS, progress)
        return None if end is None else self.plane.from_plane(law.system(end[1].theta))

    def _hidden(self, law: ControllerStructure, theta: FloatArray, scenarios: Sequence[Scenario]) -> bool:
        """Return whether a bound is exceeded between the lines of a plant; those lines are taken in."""
        system, found = self.plane.from_plane(law.system(theta)), False
        for scenario in scenarios:
            excess, at_hz = exceeded(scenario.plant, system, self.demands)
            if excess > HIDDEN_DB and np.isfinite(at_hz):
                found = scenario.add(self.plane.of_hz(at_hz * FAN)) or found
        return found

    def _scenarios(self, plants: Sequence[StateSpace]) -> list[Scenario]:
        return [Scenario(g, self.plane, self._f, self.demands.band_hz) for g in plants]

    def _searched(
        self, law: ControllerStructure, theta: FloatArray, scenarios: list[Scenario], steps: int, progress: Task
    ) -> tuple[ControllerStructure, SearchEnd] | None:
        levels = LoopLevels(law, self.demands, scenarios)
        calm = calmed(levels, theta)
        if calm is None:
            return None
        end = search(levels, calm, steps, progress)
        self.taken += end.steps
        self.lines = sum(s.w.size for s in scenarios)
        return law, end


def _grid(demands: Demands, rate_hz: float | None, roof_hz: float = np.inf) -> FloatArray:
    """Return lines over all decades that matter, denser in and around the band and towards Nyquist."""
    low, high = demands.band_hz
    top = high * 10**DECADES if rate_hz is None else 0.4999 * rate_hz
    start = low / 10**DECADES
    parts = [
        np.geomspace(start, top, round(LINES_A_DECADE * np.log10(top / start))),
        np.geomspace(low, high, max(round(1.5 * LINES_A_DECADE * np.log10(high / low)), 30)),
        np.geomspace(low / 2.5, 2 * low, LINES_A_DECADE),
        np.geomspace(high, min(3 * high, top), LINES_A_DECADE // 2) if high < top else np.zeros(0),
    ]
    if rate_hz is not None:
        parts.append(np.linspace(0.17, 0.4999, 60) * rate_hz)
    edge = np.array([roof_hz]) if np.isfinite(roof_hz) and roof_hz < top else np.zeros(0)
    return np.unique(np.concatenate([*parts, edge, np.array(demands.tones_hz)]))
