"""A search from several starts: on the plants given first, then with those drawn near them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.progress import Task, task
from ultraquiet.design.law_structure.controller_structure import ControllerStructure
from ultraquiet.design.law_structure.plane import plane_of
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.loops.certificate import Certified, LoopCertificate
from ultraquiet.design.peak_bounded.loops.levels import LoopLevels, Standing
from ultraquiet.design.peak_bounded.loops.scenario import Scenario
from ultraquiet.design.peak_bounded.search import FAR_DB, PRICE, SearchEnd, calmed, search, stable
from ultraquiet.design.peak_bounded.step import merit
from ultraquiet.values.state_space import StateSpace

# Plants drawn are searched on half the lines: what shows between them brings its lines, and no two stand alike.
LINES_A_DECADE, FEWER = 40, 20
NARROW = np.array([-1.0, 0.0, 1.0])
DECADES = 2.0  # below the band; above it the grid goes to Nyquist, or as far
# Steps from each start, of which few go on for the first part of all steps, and then the best: so early the best start
# is not the one that ends best, up to 2 dB apart.
LOOKS, FEW, FIRST_PART = 8, 2, 0.4
POLISH = 3  # on a line that shows an excess: the first step or two take it away
# Of looks between the lines, and what counts as a bound exceeded there: on a plant given, and on one drawn.
ROUNDS, HIDDEN_DB, HIDDEN_DRAWN_DB = 6, 0.01, 0.1
FAN = np.array([0.995, 1.0, 1.005])  # lines around such a place

NEARLY_DB, QUIET_DB = 0.1, 3.0  # a start that keeps its bounds so nearly and attenuates by so much is good enough
ROOM_DB = 0.7  # kept below the bound on S by a search without the plants drawn: they would take it
WIDENINGS, JOIN, WORSE_DB = 3, 3, 0.1  # rounds in which plants join, how many, and how much worse they must stand
# Of the spread, where the plants drawn at all of it stand so far off that a law turned down for them ends at nothing.
SHARES = (0.25, 0.5, 0.75)

Start = tuple[ControllerStructure, FloatArray]
Near = Callable[[float], Sequence[StateSpace]]


class SearchFromStarts:
    """Demands, plants in the units of the search, and how long to search.

    Args:
        demands: on every plant.
        plants: those given.
        near: of a share of the spreads, those drawn near them; None where none are to be held.
        steps: on the plants given, and again with all, at most.
        roof_hz: a line that the grid must hold.
    """

    def __init__(
        self, demands: Demands, plants: Sequence[StateSpace], near: Near | None, steps: int, roof_hz: float
    ) -> None:
        self.demands, self.plants, self.near, self.steps = demands, tuple(plants), near, steps
        self.plane = plane_of(self.plants[0])
        self.taken, self.lines = 0, 0
        self.excess_db: tuple[float, ...] = ()  # over a bound, on each plant given
        self.alone_db = -np.inf  # attenuation before plants near have a say
        self.drawn: tuple[Certified, ...] = ()  # what the law reaches on the plants near
        self._pool: list[Scenario] = []
        rate_hz = self.plants[0].rate_hz
        self._f, self._coarse = (_grid(demands, rate_hz, each, roof_hz) for each in (LINES_A_DECADE, FEWER))

    def best(self, starts: Sequence[Start]) -> StateSpace | None:
        """Return the law that a search from the best of several starts ends with; None where none is stable.

        Plants drawn near join the search as soon as one of them stands worse than those that are in it.
        """
        given = self._scenarios(self.plants)
        first = round(FIRST_PART * self.steps)
        with task("peak-bounded search", LOOKS * len(starts) + (FEW - 1) * first + 2 * self.steps) as progress:
            looks = self._looked(starts, given, progress)
            if not looks:
                return None
            law, look, further = self._best(looks, given, first, progress)
            end = self._searched(law, further.theta, given, self.steps - first, progress, self._tighter())
            every = given
            self.alone_db = -np.inf if end is None else -float(end[1].standing.level_db)
            if end is not None and self.near:
                end, every = self._widened(law, (end[1], look), given, progress)
            certificates = [LoopCertificate(each, self.demands) for each in every]
            for _ in range(ROUNDS):
                if end is None or not self._hidden(law, end[1].theta, certificates):
                    break
                end = self._searched(law, end[1].theta, every, POLISH, progress)
        if end is None:
            return None
        theta, known = end[1].theta, {id(each.scenario): each for each in certificates}
        self.excess_db = tuple(each.excess(law, theta)[0] for each in certificates[: len(given)])
        drawn = [known.get(id(each)) or LoopCertificate(each, self.demands) for each in self._pool]
        self.drawn = tuple(each.of(law, theta) for each in drawn)
        return law.law(end[1].theta, self.plane)

    def _tighter(self) -> Demands:
        """Return the demands with room kept for the plants drawn, of which a search without them would leave none."""
        own, room = self.demands.sensitivity_db, ROOM_DB if self.near else 0.0
        return replace(self.demands, sensitivity_db=lambda f_hz: own(f_hz) - room)

    def _looked(
        self, starts: Sequence[Start], given: list[Scenario], progress: Task
    ) -> list[tuple[ControllerStructure, SearchEnd]]:
        """Return where some steps lead from each start, the best first; a poor one is left where another does well."""
        looks: list[tuple[ControllerStructure, SearchEnd]] = []
        for k, start in enumerate(starts):
            if k == len(starts) - 1 and any(_good(each[1].standing) for each in looks):
                break
            end = self._searched(*start, given, LOOKS, progress)
            looks += [] if end is None else [end]
        return sorted(looks, key=lambda each: _worth(each[1].standing))

    def _best(
        self,
        looks: Sequence[tuple[ControllerStructure, SearchEnd]],
        given: list[Scenario],
        steps: int,
        progress: Task,
    ) -> tuple[ControllerStructure, SearchEnd, SearchEnd]:
        """Return the structure of that of few looks which goes on best, the look, and where it stands by then."""
        ends: list[tuple[ControllerStructure, SearchEnd, SearchEnd]] = []
        for law, look in looks[:FEW]:
            _, end = self._searched(law, look.theta, given, steps, progress) or (law, look)
            ends.append((law, look, end))
        return min(ends, key=lambda each: _worth(each[2].standing))

    def _widened(
        self, law: ControllerStructure, ends: tuple[SearchEnd, SearchEnd], given: list[Scenario], progress: Task
    ) -> tuple[tuple[ControllerStructure, SearchEnd] | None, list[Scenario]]:
        """Return the end of a search on the plants given and on those drawn that decide, and all of these.

        It goes on from the first of two ends, by growing shares of the spread where a plant drawn at all of it is
        unstable or far off: turning the law down for it leads nowhere. For the same reason each further search is also
        made from that end before which stands best on all its plants.
        """
        self._pool = self._drawn(1.0)
        working: list[Scenario] = []
        before, now = [ends[1]], ends[0]
        for turn in range(WIDENINGS):
            stands = self._stand(law, now.theta, self._pool)
            if turn == 0 and any(excess > FAR_DB for _, excess in stands):
                *grown, now = self._grown(law, now, given, progress)
                before += grown
                stands = self._stand(law, now.theta, self._pool)
            worth = [worth for worth, _ in stands]
            limit = _worth(now.standing) + WORSE_DB
            more = [
                i for i in np.argsort(worth, kind="stable")[::-1] if worth[i] > limit and self._pool[i] not in working
            ][:JOIN]
            if not more:
                break
            working += [self._pool[i] for i in more]
            plants = [*given, *working]
            best = min((*before, now), key=lambda end: max(worth for worth, _ in self._stand(law, end.theta, plants)))
            begins = [now] if best is now else [now, best]
            trials = [self._searched(law, each.theta, plants, self.steps // 2, progress) for each in begins]
            found = [each[1] for each in trials if each is not None]
            if not found:
                return None, plants
            before, now = [*before, now], min(found, key=lambda each: _worth(each.standing))
        return (law, now), [*given, *working]

    def _grown(
        self, law: ControllerStructure, end: SearchEnd, given: list[Scenario], progress: Task
    ) -> list[SearchEnd]:
        """Return an end and those of searches from it on the plants given and the worst at growing shares of spread."""
        ends = [end]
        for share in SHARES:
            pool = self._drawn(share)
            worth = [worth for worth, _ in self._stand(law, ends[-1].theta, pool)]
            worst = [pool[i] for i in np.argsort(worth, kind="stable")[::-1][:JOIN]]
            found = self._searched(law, ends[-1].theta, [*given, *worst], self.steps // 4, progress)
            ends += [] if found is None else [found[1]]
        return ends

    def _stand(
        self, law: ControllerStructure, theta: FloatArray, pool: Sequence[Scenario]
    ) -> list[tuple[float, float]]:
        """Return of each plant what the law is worth on it and what it exceeds, both infinite where it is unstable."""
        levels = [LoopLevels(law, self.demands, [each]) for each in pool]
        stands = [each.standing(theta) if stable(each, theta) else None for each in levels]
        return [(np.inf, np.inf) if s is None else (_worth(s), s.excess_db) for s in stands]

    def _drawn(self, share: float) -> list[Scenario]:
        """Return plants drawn at a share of the spreads."""
        near = self.near(share) if self.near else ()
        return [Scenario(g, self.plane, self._coarse, self.demands.band_hz, NARROW) for g in near]

    def _hidden(self, law: ControllerStructure, theta: FloatArray, certificates: Sequence[LoopCertificate]) -> bool:
        """Return whether bounds are exceeded between the lines of a plant; all those lines are taken in."""
        found = False
        for k, certificate in enumerate(certificates):
            at_hz = certificate.exceeded_hz(law, theta, HIDDEN_DB if k < len(self.plants) else HIDDEN_DRAWN_DB)
            found = certificate.scenario.add(self.plane.of_hz((at_hz[:, None] * FAN).ravel())) or found
        return found

    def _scenarios(self, plants: Sequence[StateSpace]) -> list[Scenario]:
        return [Scenario(g, self.plane, self._f, self.demands.band_hz) for g in plants]

    def _searched(
        self,
        law: ControllerStructure,
        theta: FloatArray,
        scenarios: list[Scenario],
        steps: int,
        progress: Task,
        demands: Demands | None = None,
    ) -> tuple[ControllerStructure, SearchEnd] | None:
        levels = LoopLevels(law, demands or self.demands, scenarios)
        calm = calmed(levels, theta)
        if calm is None:
            return None
        end = search(levels, calm, steps, progress)
        self.taken += end.steps
        self.lines = sum(s.w.size for s in scenarios)
        return law, end


def _grid(demands: Demands, rate_hz: float | None, a_decade: int, roof_hz: float = np.inf) -> FloatArray:
    """Return lines over all decades that matter, denser in and around the band and towards Nyquist."""
    low, high = demands.band_hz
    top = high * 10**DECADES if rate_hz is None else 0.4999 * rate_hz
    start = low / 10**DECADES
    parts = [
        np.geomspace(start, top, round(a_decade * np.log10(top / start))),
        np.geomspace(low, high, max(round(1.5 * a_decade * np.log10(high / low)), 30)),
        np.geomspace(low / 2.5, 2 * low, a_decade),
        np.geomspace(high, min(3 * high, top), a_decade // 2) if high < top else np.zeros(0),
    ]
    if rate_hz is not None:
        parts.append(np.linspace(0.17, 0.4999, round(1.5 * a_decade)) * rate_hz)
    edge = np.array([roof_hz]) if np.isfinite(roof_hz) and roof_hz < top else np.zeros(0)
    return np.unique(np.concatenate([*parts, edge, np.array(demands.tones_hz)]))


def _worth(standing: Standing) -> float:
    return merit(standing.level_db, standing.excess_db, PRICE)


def _good(standing: Standing) -> bool:
    return standing.excess_db < NEARLY_DB and standing.level_db < -QUIET_DB
