"""One controller on many plants: the share that is stable, and how the figures of the loop spread."""

from collections.abc import Iterable, Mapping, Sized
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, frozen, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.shown.line import rounded
from ultraquiet.analyse.disk import disk_margin
from ultraquiet.analyse.margins import Margins, loop_margins, peak_sensitivity
from ultraquiet.analyse.peaks import refined, response_at
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

CONFIDENCE = 0.95
IN_BAND = 300  # lines a band; peaks between them are refined
QUANTILES = (0.05, 0.5, 0.95)
# What a figure is where the loop is unstable, and whether a large one is bad.
PEAK, ATTENUATION = "peak_sensitivity_db", "worst_direction_db"
UNSTABLE = {PEAK: np.inf, ATTENUATION: -np.inf}


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """How one controller does on many plants or benches.

    Attributes:
        stable: `(n,)` whether each loop is.
        figures: name -> `(n,)`: `peak_sensitivity_db` (infinite where unstable), `worst_direction_db` reduction of the
            worst direction over the band (minus infinity where unstable), margins (zero where unstable).
        worst: index of the worst case: an unstable one, else the one with the highest peak.
        worst_case: the plant or bench of that index.
        band_hz: the band, Hz.
    """

    stable: np.ndarray[Any, np.dtype[np.bool_]]
    figures: Mapping[str, FloatArray]
    worst: int
    worst_case: Any
    band_hz: tuple[float, float]

    @property
    def share_stable(self) -> float:
        """Share of the loops that are stable."""
        return float(self.stable.mean())

    def share_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Return Wilson's interval for the share of all plants of this kind on which the loop would be stable."""
        return wilson_interval(int(self.stable.sum()), self.stable.size, confidence)

    def quantile(self, figure: str, share: float) -> float:
        """Return the value of a figure below which `share` of the cases lie, unstable ones counted at their worst."""
        if figure not in self.figures:
            raise InputError(f"MonteCarlo: there is no figure '{figure}'; known are {', '.join(self.figures)}.")
        values = np.sort(self.figures[figure])
        # the case itself and no mean of two: one of them may be infinite
        return float(values[round(between("MonteCarlo.quantile", "share", share, 0.0, 1.0) * (values.size - 1))])

    def summary(self) -> dict[str, Any]:
        """Return share, interval, worst case and the 5, 50 and 95 % quantiles of every figure."""
        spread = {name: tuple(self.quantile(name, q) for q in QUANTILES) for name in self.figures}
        interval = self.share_interval()
        return {"cases": self.stable.size, "share_stable": self.share_stable, "interval": interval, **spread}

    def status(self) -> Status:
        """Say what may be promised."""
        n, lost = self.stable.size, int((~self.stable).sum())
        low = self.share_interval()[0]
        if lost:
            return Status(
                StatusWord.UNSTABLE, f"The loop is unstable on {lost} of {n} cases, one of them case {self.worst}."
            )
        peak = self.figures[PEAK][self.worst]
        return Status(
            StatusWord.OK,
            f"The loop is stable on all {n} cases ({CONFIDENCE:.0%} sure of {low:.1%} of such plants); the highest "
            f"peak is {rounded(peak)} dB, in case {self.worst}.",
        )


def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the interval in which the true share lies with the confidence given, sensible at 0 and 100 % too.

    Args:
        successes: seen.
        trials: made.
        confidence: between 0.5 and 0.9999.

    >>> [round(share, 3) for share in wilson_interval(100, 100)]
    [0.963, 1.0]

    Wilson 1927, doi:10.1080/01621459.1927.10502953.
    """
    who = "wilson_interval"
    whole(who, "successes", successes, 0, whole(who, "trials", trials, 1))
    between(who, "confidence", confidence, 0.5, 0.9999)
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    share, spread = successes / trials, z * z / trials
    middle = (share + spread / 2) / (1 + spread)
    half = z / (1 + spread) * float(np.sqrt(share * (1 - share) / trials + spread / (4 * trials)))
    # at both ends the formula is exact and only rounding would leave the unit interval
    return (0.0 if successes == 0 else middle - half), (1.0 if successes == trials else middle + half)


def monte_carlo(
    plants: Iterable[StateSpace], controller: StateSpace, band_hz: tuple[float, float] | None = None
) -> MonteCarlo:
    """Close the loop with every plant and return the spread of what it does.

    Args:
        plants: models: drawn from the covariance of an identification (`validate.drawn_plants`), of several records, or
            of several units; an iterator is asked for one at a time.
        controller: K, u = K y.
        band_hz: where the reduction of the worst direction counts, (low, high) in Hz; all frequencies when absent.

    Returns:
        `MonteCarlo`, with `peak_sensitivity_db`, `worst_direction_db`, `disk_margin` (all loops at the plant's outputs
        at the same time), `gain_margin_db`, `phase_margin_deg` and `delay_margin_s` (smallest over loops and sides).

    Raises:
        InputError: no plants, one that does not fit the controller, a band that is none or ends beyond Nyquist.

    >>> plants = [StateSpace([[a]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0) for a in (0.3, 0.5, 1.6)]
    >>> found = monte_carlo(plants, StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0), (0.0, 5.0))
    >>> found.stable.tolist(), found.worst, round(found.quantile("worst_direction_db", 1.0), 2)
    ([True, True, False], 2, 5.24)
    """
    if band_hz is not None:
        checked_band("monte_carlo", band_hz)
    total = len(plants) if isinstance(plants, Sized) else 0
    rows: list[dict[str, float]] = []
    worst, badness, case = 0, -np.inf, None
    with task("loops", total) as progress:
        for k, plant in enumerate(plants):
            if band_hz is not None:
                checked_band("monte_carlo", band_hz, plant.rate_hz)
            rows.append(_figures(plant, controller, band_hz))
            progress.advance(note=f"plant {k + 1}")
            if case is None or rows[-1][PEAK] > badness:
                worst, badness, case = k, rows[-1][PEAK], plant
    return collected("monte_carlo", rows, worst, case, band_hz or (0.0, np.inf))


def collected(
    who: str, rows: list[dict[str, float]], worst: int, case: Any, band_hz: tuple[float, float]
) -> MonteCarlo:
    """Return the figures of many cases as one value; a case with an infinite peak is unstable."""
    if not rows:
        raise InputError(f"{who}: give at least one plant.")
    figures = {name: frozen(np.array([row[name] for row in rows])) for name in rows[0]}
    return MonteCarlo(frozen(np.isfinite(figures[PEAK])), figures, worst, case, band_hz)


def checked_band(who: str, band_hz: tuple[float, float], rate_hz: float | None = None) -> None:
    """Refuse a band that does not rise, or ends beyond Nyquist where a rate is given."""
    if np.shape(band_hz) != (2,):
        raise InputError(f"{who}: 'band_hz' must be two frequencies in Hz, got {band_hz!r}.")
    low, high = band_hz
    between(who, "band_hz", low, 0.0, positive(who, "band_hz", high, "Hz"), "Hz")
    if rate_hz is not None and high > rate_hz / 2:
        raise InputError(f"{who}: 'band_hz' ends at {high:g} Hz, beyond Nyquist's {rate_hz / 2:g} Hz; end it lower.")


def _figures(plant: StateSpace, controller: StateSpace, band_hz: tuple[float, float] | None) -> dict[str, float]:
    peak, _ = peak_sensitivity(plant, controller)
    if not np.isfinite(peak):
        names = ("disk_margin", "gain_margin_db", "phase_margin_deg", "delay_margin_s")
        return {**UNSTABLE, **dict.fromkeys(names, 0.0)}
    worst = -peak if band_hz is None else _worst_in_band(sensitivity(plant, controller), *band_hz)
    sides = [loop_margins(plant, controller, side) for side in ("output", "input")]
    gains = [np.minimum(side.gain_up_db, side.gain_down_db) for side in sides]
    return {
        PEAK: peak,
        ATTENUATION: worst,
        "disk_margin": disk_margin(plant, controller),
        "gain_margin_db": float(min(gain.min() for gain in gains)),
        "phase_margin_deg": _least(sides, "phase_deg"),
        "delay_margin_s": _least(sides, "delay_s"),
    }


def _least(sides: list[Margins], name: str) -> float:
    return float(min(getattr(side, name).min() for side in sides))


def _worst_in_band(S: StateSpace, low: float, high: float) -> float:
    """Return the reduction in dB of the worst direction over a band."""
    response = response_at(S)

    def at(f: FloatArray) -> FloatArray:
        return np.linalg.norm(np.moveaxis(response(f), 2, 0), 2, axis=(1, 2))

    poles = S.poles()
    own = np.abs(poles.imag) if S.rate_hz is None else np.abs(np.angle(poles)) * S.rate_hz
    own = own / (2 * np.pi)
    f = np.unique(np.concatenate([np.linspace(low, high, IN_BAND), own[(own > low) & (own < high)]]))
    return -20 * float(np.log10(refined(at, f, at(f))[0]))
