"""One search for a limit: grid, basis and lines of a scalar loop, the programme on them, and its proof."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.shown.line import counted, hertz, loudness
from ultraquiet.limits import certificate, grid, half_plane
from ultraquiet.limits._limit import Limit, attenuation, refused
from ultraquiet.limits.basis import OrthonormalBasis, chain
from ultraquiet.limits.circle import Circle
from ultraquiet.limits.demands import ERROR, IN_BAND, WHO, Wishes
from ultraquiet.limits.loops import AffineLoops, Loops
from ultraquiet.limits.programme import ConeSolution, Demand, solve, solve_on
from ultraquiet.linalg.zeros import invariant_zeros
from ultraquiet.values.status import Status, StatusWord

# Points from 0 to pi for the certificate, over how many a jump is smoothed, how multipliers become weights; the next
# where one is too coarse or tells nothing: a demand that binds over a narrow stretch, as a control gain far below the
# band does, is smeared away.
CIRCLES = (
    (1 << 14, 16, certificate.weights_at),
    (1 << 14, 16, certificate.weights_between),
    (1 << 16, 30, certificate.weights_between),
    (1 << 15, 40, certificate.weights_at),
    (1 << 16, 30, certificate.weights_at),
    (1 << 14, 8, certificate.weights_at),
    (1 << 16, 8, certificate.weights_at),
)
USED_UP = 0.99  # share of a demand from which on it binds
QUADRATURE = 1 << 13
NEGLIGIBLE = 1e-3  # share of a demand by which it may be exceeded between points
EXCEEDED = 0.01  # from here on a law does not keep the demand, and is no proof of what can be had
# Of the control gain, where the solver gives up on all of it, and how many of them are to give a solution.
SHARES, ENOUGH = (0.3, 0.1, 0.03, 0.01, 0.003), 3
GRIDS = 3  # made after the first where a law exceeds a demand between the points
INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
NAMED = 3  # demands that a sentence names; the others it counts
ASIDE_DB = (0.0, 0.1, 0.3)  # by which a bound may move from one circle to a finer one
FINE_BAND = 4001  # points at which an error is looked at, besides the grid's own
GUESSES = 3  # of the level, where what it is worth decides
WORTH = 0.02  # error times level below which |1 - S| counts as one
GAINED = 1e-4  # share of a level that another guess must gain
NONE_IS_SURE = "no controller makes every such plant quieter there"
DEEP_DB = 90.0  # from here on levels are so far apart that poles at an edge add more rounding than attenuation

Stretches = tuple[tuple[float, float], ...]


class LimitSearch:
    """Everything that depends on plant, band and basis, but not on the demands."""

    def __init__(self, loops: Loops, band_hz: tuple[float, float], basis: int, narrow: bool = False) -> None:
        plant = loops.plant
        self.loops, self.band_hz, self.states, self.narrow = loops, band_hz, basis, narrow
        self.circle = Circle(plant.rate_hz, float(np.sqrt(band_hz[0] * band_hz[1])))
        zeros = invariant_zeros(plant.A, plant.B, plant.C, plant.D)
        self.roots = half_plane.half_plane(np.concatenate([plant.poles(), zeros, *self._regulated()]), plant.rate_hz)
        self.poles = grid.basis_poles(self.roots, self.circle, band_hz, basis, narrow)
        self.basis = chain(self.poles)
        self.f_hz = grid.frequencies(self.roots, self.circle, band_hz)
        self.lines = loops.at(self.f_hz)
        self.inside = (self.f_hz >= band_hz[0]) & (self.f_hz <= band_hz[1])

    def _regulated(self) -> list[ComplexArray]:
        """Return the poles that a Youla parametrisation brings in."""
        G, F, H = self.loops.plant, self.loops.F, self.loops.H
        return [
            np.linalg.eigvals(M).astype(np.complex128) for M in (G.A + G.B @ F, G.A + H @ G.C) if F.any() or H.any()
        ]

    def limit(
        self,
        wishes: Wishes,
        noise_gain: float | None = None,
        certify: bool = True,
        bounded_by: Callable[[FloatArray], AffineLoops] | None = None,
    ) -> Limit:
        """Return the limit under these demands.

        The bound is that of the loop `bounded_by`; its own when absent, and then half of the basis is tried too. In a
        narrow band poles closer to its edges are tried beside the others, where what is reached is not beyond numbers.
        """
        found = self._limit(wishes, noise_gain, certify, bounded_by)
        deep = found.controller is None or found.attenuation_db > DEEP_DB
        if self.narrow or deep or not grid.is_narrow(self.band_hz):
            return found
        closer = LimitSearch(self.loops, self.band_hz, self.states, narrow=True)
        again = closer.limit(wishes, noise_gain, certify, bounded_by)
        return max(found, again, key=lambda limit: (limit.status.ok, limit.attenuation_db))

    def _limit(
        self,
        wishes: Wishes,
        noise_gain: float | None,
        certify: bool,
        bounded_by: Callable[[FloatArray], AffineLoops] | None,
    ) -> Limit:
        """Return the limit of these functions, sought anew where a law exceeds a demand between the points."""
        f = np.union1d(grid.finer(self.f_hz[self.inside]), np.geomspace(*wishes.band_hz, FINE_BAND))
        error = wishes.errors(f)
        if error is not None and error.max() >= 1:
            at = hertz(float(f[np.argmax(error)]))
            return refused(f"{WHO}: the plant may be off by {100 * error.max():.3g} % at {at}; {NONE_IS_SURE}.")
        found, broken, solution = self._on_the_grid(wishes, noise_gain, certify, bounded_by)
        for _ in range(GRIDS):
            if found.violation < NEGLIGIBLE:
                break
            start = self._look_at(broken, solution)
            again, broken, solution = self._on_the_grid(wishes, noise_gain, certify, bounded_by, start)
            if again.controller is None:
                break
            found = again
        return found

    def _look_at(self, f_hz: FloatArray, solution: ConeSolution) -> ConeSolution:
        """Put places into the grid at which a law exceeds a demand between its points; bring the solution there."""
        known, self.f_hz = self.f_hz, np.unique(np.concatenate([self.f_hz, f_hz]))
        self.lines = self.loops.at(self.f_hz)
        self.inside = (self.f_hz >= self.band_hz[0]) & (self.f_hz <= self.band_hz[1])
        put = [np.isin(self.f_hz, known[on]) for on in solution.active]
        return replace(solution, active=put)

    def _on_the_grid(
        self,
        wishes: Wishes,
        noise_gain: float | None,
        certify: bool,
        bounded_by: Callable[[FloatArray], AffineLoops] | None,
        start: ConeSolution | None = None,
    ) -> tuple[Limit, FloatArray, ConeSolution]:
        """Return the limit by the demands at the grid's points, where between them one is exceeded, the solution."""
        solution, gain = self._solved(wishes, noise_gain, start)
        wishes, solution = self._at_its_level(wishes, noise_gain, solution, gain)
        if not solution.ok:
            return refused(self._why(wishes, noise_gain, solution)), np.zeros(0), solution
        asked = replace(wishes, control_gain=gain)
        demands = asked.demands(self.f_hz, self.lines)
        bound = float("nan")
        if certify:
            # the noise gain is no demand at single frequencies: the bound is that of the others
            others = solution
            if noise_gain is not None:
                others = solve_on(self._functions(self.basis, gain), demands, solution.active)
            bound = self.bound(wishes, demands, others, bounded_by or self.loops.at)
        half_db = float("nan") if bounded_by else self._half(asked, demands, solution, noise_gain)
        found, broken = self._judged(wishes, solution, gain, bound, half_db)
        if certify and found.status.ok and not np.isfinite(bound):
            found = replace(found, status=Status(StatusWord.NOT_CERTIFIED, found.status.sentence))
        return found, broken, solution

    def _solved(
        self, wishes: Wishes, noise_gain: float | None, start: ConeSolution | None
    ) -> tuple[ConeSolution, float]:
        """Return the solution and the control gain it was sought with, the one allowed or a share of it.

        Q is sought in units of that gain. Where it is far beyond what the band takes, Q is a small difference of large
        numbers, on which the solver gives up: less of it keeps the demand as well. Of a few such solutions, each good
        to what rounding leaves, the one with the lowest level is taken.
        """
        gain = wishes.control_gain
        first = self._posed(wishes, noise_gain, start)
        if first.ok or first.status in INFEASIBLE:
            return first, gain
        found: list[tuple[ConeSolution, float]] = []
        for share in SHARES:
            solution = self._posed(replace(wishes, control_gain=share * gain), noise_gain, start)
            found += [(solution, share * gain)] if solution.ok else []
            if len(found) == ENOUGH:
                break
        return min(found, key=lambda f: f[0].level, default=(first, gain))

    def _at_its_level(
        self, wishes: Wishes, noise_gain: float | None, solution: ConeSolution, gain: float
    ) -> tuple[Wishes, ConeSolution]:
        """Return a better solution for every plant within an error, from guesses of its level, and the last of them."""
        error = wishes.errors(self.f_hz[self.inside])
        if error is None or not solution.ok:
            return wishes, solution
        for _ in range(GUESSES):
            level = self._level(wishes, solution, self.basis)
            if not error.max() * level > WORTH:
                break
            guessed = replace(wishes, guess=min(level, 1.0), control_gain=gain)
            again = self._posed(guessed, noise_gain, None)
            if not (again.ok and self._level(wishes, again, self.basis) < level * (1 - GAINED)):
                break
            wishes, solution = replace(guessed, control_gain=wishes.control_gain), again
        return wishes, solution

    def _posed(self, wishes: Wishes, noise_gain: float | None, start: ConeSolution | None) -> ConeSolution:
        """Return the solution of the programme, its weights those of the basis itself; so are those of the start."""
        gain = wishes.control_gain
        noise = None if noise_gain is None else self._noise(self.basis, gain, noise_gain)
        if start is not None:
            start = replace(start, weights=start.weights / gain)
        demands = wishes.demands(self.f_hz, self.lines)
        solution = solve(self._functions(self.basis, gain), demands, noise, start)
        return replace(solution, weights=solution.weights * gain)

    def _functions(self, basis: OrthonormalBasis, gain: float) -> ComplexArray:
        return gain * basis.at(self.circle.angles(self.f_hz))

    def _half(
        self, wishes: Wishes, demands: Sequence[Demand], solution: ConeSolution, noise_gain: float | None
    ) -> float:
        """Return the attenuation in dB that every other section of the basis reaches on the same points."""
        half, gain = chain(self.poles[::2]), wishes.control_gain
        noise = None if noise_gain is None else self._noise(half, gain, noise_gain)
        again = solve_on(self._functions(half, gain), demands, solution.active, noise)
        again = replace(again, weights=again.weights * gain)
        return attenuation(self._level(wishes, again, half)) if again.ok else float("nan")

    def _level(self, wishes: Wishes, solution: ConeSolution, basis: OrthonormalBasis) -> float:
        """Return the largest |S| in the band, on the grid, of the worst plant within the error."""
        if wishes.error is None:
            return solution.level
        f = self.f_hz[self.inside]
        q = solution.weights @ basis.at(self.circle.angles(f))
        return float(wishes.largest(f, self.lines.a[self.inside] + self.lines.b[self.inside] * q).max())

    def _noise(self, basis: OrthonormalBasis, scale: float, noise_gain: float) -> FloatArray:
        """Return R with |R (theta, 1)| = ||K S||_2 / noise_gain, the mean square over all frequencies."""
        rate_hz = self.circle.rate_hz
        assert rate_hz is not None
        edges = np.unique(np.concatenate([np.linspace(0, rate_hz / 2, QUADRATURE), self.f_hz]))
        f, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
        lines = self.loops.at(f)
        rows = np.vstack([basis.at(self.circle.angles(f)) * lines.d * scale, lines.c]).T
        rows *= np.sqrt(width / width.sum())[:, None] / noise_gain
        return np.asarray(np.linalg.qr(np.vstack([rows.real, rows.imag]), mode="r"))

    def bound(
        self,
        wishes: Wishes,
        demands: Sequence[Demand],
        solution: ConeSolution,
        lines: Callable[[FloatArray], AffineLoops],
    ) -> float:
        """Return the attenuation in dB that no Q reaches on `lines`; nan where no circle was fine enough.

        Infinite where those that were told of no level out of reach.
        """
        merged = [[0, 1], *([k] for k in range(2, len(demands)))]  # the band's demand and the peak's are one, of S
        multipliers = [sum((solution.multipliers[k] for k in ks), np.zeros(self.f_hz.size)) for ks in merged]
        active = [np.any([solution.active[k] for k in ks], axis=0) for ks in merged]
        reached = self._level(wishes, solution, self.basis)
        told, on_circle = float("nan"), partial(self._on_circle, wishes, lines, multipliers, active)
        for count, smoothed, weigh in CIRCLES:
            level = certificate.lowest_level(*on_circle(count, smoothed, weigh), reached)
            if level > 0:
                # the same discs and weights seen twice as closely: a circle too coarse for them may tell what is not so
                closely = on_circle(2 * count, 2 * smoothed, weigh)
                for aside_db in ASIDE_DB:
                    lower = level * 10 ** (-aside_db / 20)
                    if certificate.hankel_measure(*closely, lower)[0] > 1:
                        return attenuation(lower)
            told = np.inf if level == 0 else told
        return told

    def _on_circle(
        self,
        wishes: Wishes,
        lines: Callable[[FloatArray], AffineLoops],
        multipliers: Sequence[FloatArray],
        active: Sequence[np.ndarray],
        count: int,
        smoothed: int,
        weigh: Callable[..., FloatArray],
    ) -> tuple[list[certificate.Merged], FloatArray]:
        """Return demands and weights on so many equal angles, jumps smoothed over so many of them."""
        angles = np.linspace(0, np.pi, count + 1)
        edges = self.circle.angles(np.array(self.band_hz))
        share = certificate.ramp(angles, edges[0], edges[1], smoothed)
        f_hz = self.circle.frequencies(angles)
        wanted = wishes.demands(f_hz, lines(f_hz))[1:]
        levels = [share, *np.zeros(len(wanted) - 1)]
        discs = [
            certificate.Merged(d.a, d.b, d.limit ** (1 - s), s, d.error) for d, s in zip(wanted, levels, strict=True)
        ]
        grid_angles = self.circle.angles(self.f_hz)
        return discs, weigh(angles, smoothed, grid_angles, multipliers, active)

    def _judged(
        self, wishes: Wishes, solution: ConeSolution, gain: float, bound_db: float, half_db: float
    ) -> tuple[Limit, FloatArray]:
        """Judge the solution on a finer grid and word it; return where it exceeds a demand there, too."""
        f = grid.finer(self.f_hz)
        lines = self.loops.at(f)
        q = solution.weights @ self.basis.at(self.circle.angles(f))
        S, size = wishes.largest(f, lines.a + lines.b * q), np.abs(lines.c + lines.d * q)
        inside = wishes.inside(f)
        level = float(S[inside].max())
        reached = {d.name: d.reached(q, level) for d in wishes.demands(f, lines)}
        reached[IN_BAND] = np.where(inside, S / level, 0.0)
        over = max(float(r.max()) for r in reached.values()) - 1
        binding = {name: _stretches(f, r >= USED_UP) for name, r in reached.items()}
        law = self.loops.controller(self.circle.unwarped(self.basis.realised(solution.weights)))
        values = attenuation(level), bound_db, 20 * float(np.log10(S.max())), float(size.max())
        sought = "" if gain == wishes.control_gain else f" that keep |K S| below {gain:.3g}"
        word = StatusWord.OK if over < EXCEEDED else StatusWord.SHORT
        sure = ", on the worst plant within the uncertainty" * (wishes.error is not None)
        status = Status(word, self._sentence(solution, *values[:2], over, half_db, binding, sought, sure))
        broken = f[np.any([r > 1 + NEGLIGIBLE for r in reached.values()], axis=0)]
        return Limit(status, *values, law, f, S, binding, half_db, self.basis.size, max(over, 0.0)), broken

    def _sentence(
        self,
        solution: ConeSolution,
        attenuation_db: float,
        bound_db: float,
        over: float,
        half_db: float,
        binding: Mapping[str, Stretches],
        sought: str,
        sure: str,
    ) -> str:
        low, high = self.band_hz
        bound = f"none exceeds {bound_db:.1f} dB" if np.isfinite(bound_db) else "no bound was certified"
        used = [f"{name} over {_words(spans)}" for name, spans in binding.items() if name != IN_BAND and spans]
        more = f" and {counted(len(used) - NAMED, 'other demand')}" if len(used) > NAMED else ""
        kept = "every demand holds" if over < NEGLIGIBLE else f"demands are exceeded by up to {100 * over:.2g} %"
        less = f" ({half_db:.1f} dB with half of them)" if np.isfinite(half_db) else ""
        return (
            f"{_reached(attenuation_db, f'{low:.4g}-{high:.4g} Hz')}{sure}, {bound}; used up: "
            f"{', '.join(used[:NAMED]) or 'nothing'}{more}; {kept} on a grid four times as fine; {solution.found} "
            f"after {solution.rounds} grids among controllers of {self.basis.size} functions{sought}{less}."
        )

    def _why(self, wishes: Wishes, noise_gain: float | None, solution: ConeSolution) -> str:
        """Name the demands without which there is a solution."""
        if solution.status not in INFEASIBLE:
            return f"{WHO}: {solution.found}; ask for less basis or a milder demand."
        functions = self._functions(self.basis, wishes.control_gain)
        demands = wishes.demands(self.f_hz, self.lines)
        noise = None if noise_gain is None else self._noise(self.basis, wishes.control_gain, noise_gain)
        guilty = [
            demand.name
            for k, demand in enumerate(demands)
            if not demand.sought and solve(functions, [*demands[:k], *demands[k + 1 :]], noise).ok
        ]
        if noise is not None and solve(functions, demands).ok:
            guilty.append("noise gain")
        if wishes.error is not None:
            certain = replace(wishes, error=None).demands(self.f_hz, self.lines)
            guilty += [ERROR] if solve(functions, certain, noise).ok else []
        named = (
            f"give way in: {' or '.join(guilty)}"
            if guilty
            else "no single demand is to blame, several exclude each other"
        )
        return f"{WHO}: no stabilising controller keeps all demands; {named}."


def _stretches(f_hz: FloatArray, on: np.ndarray) -> Stretches:
    """Return the intervals over which `on` holds; those a semitone or a few points apart are one."""
    spans: list[list[int]] = []
    for k in np.flatnonzero(on):
        if spans and (k - spans[-1][1] <= 3 * grid.FINER or f_hz[k] <= f_hz[spans[-1][1]] * 2 ** (1 / 12)):
            spans[-1][1] = int(k)
        else:
            spans.append([int(k), int(k)])
    return tuple((float(f_hz[first]), float(f_hz[last])) for first, last in spans)


def _reached(attenuation_db: float, band: str) -> str:
    """Say what the best controller reaches in every direction over the whole band.

    >>> _reached(3.54, "2-20 Hz"), _reached(0.0, "2-20 Hz")
    ('A controller gets 2-20 Hz quieter by 3.5 dB everywhere', 'No controller found gets 2-20 Hz quieter everywhere')
    >>> _reached(-3.0, "2-20 Hz")
    'No controller found gets 2-20 Hz quieter everywhere, the best gets the worst of it louder by 3.0 dB'
    """
    size = loudness(attenuation_db)
    if size.startswith("quieter"):
        return f"A controller gets {band} {size} everywhere"
    none = f"No controller found gets {band} quieter everywhere"
    return f"{none}, the best gets the worst of it {size}" if size.startswith("louder") else none


def _words(spans: Stretches) -> str:
    """Name the widest stretch and count the others, which is all that a reader takes in.

    >>> _words(((2.74, 4.87), (103.0, 760.0), (903.0, 969.0))), _words(((5.0, 5.0),))
    ('103-760 Hz and 2 narrower stretches', '5 Hz')
    """
    low, high = max(spans, key=lambda span: span[1] - span[0])
    widest = f"{low:.4g}-{high:.4g} Hz" if high > low else f"{low:.4g} Hz"
    others = len(spans) - 1
    return f"{widest} and {counted(others, 'narrower stretch', 'narrower stretches')}" if others else widest
