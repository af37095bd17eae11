"""A law is made again on the unit that flies: from a fresh record of it, beginning with the law that is there."""

import time
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, rising_band
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.design import DesignResult
from ultraquiet.identify import Rational
from ultraquiet.simulate.commissioning.injection import Injection, MeasuredResponse, measured_response, open_levels
from ultraquiet.simulate.commissioning.stretches import blended, stretches
from ultraquiet.simulate.kick import swings
from ultraquiet.values import FrequencyResponse, StateSpace
from ultraquiet.values.status import Status

WHO = "tune_in_place"
READING_SHARE, COMMAND_SHARE = 0.5, 0.6  # of the ranges of sensors and actuators; no law runs
BELOW, TOP_SHARE = 10.0, 0.99  # the record begins so far below the band and ends at this share of half the rate
# Far below the band a plant is often hardly heard, and what a law does there is paid for in the band: that stretch, up
# to this share of the band's lower edge, is driven by itself, as loud as may be, and so many times longer.
FAR_BELOW, LONGER = 0.5, 4.0
PER_OCTAVE = (40, 60, 120)  # lines below, in and above the band: sharp modes stand high up
NOISE_PERIODS = 2


class Designs(Protocol):
    """A design method: settings with the verb `design`."""

    def design(self, plant: StateSpace) -> DesignResult:
        """Return a law for a plant."""
        ...


@dataclass(frozen=True, eq=False)
class Tuned:
    """A law made in place: the model of the unit, what the design says, and processor seconds of each part.

    `law` is the new one, None where the design found none.
    """

    law: StateSpace | None
    model: StateSpace
    design: DesignResult
    fit_error: float
    seconds: dict[str, float]

    @property
    def status(self) -> Status:
        """That of the design, which is judged on the identified model."""
        return self.design.status


def tune_in_place(
    bench: Bench,
    design: Designs,
    band_hz: tuple[float, float],
    *,
    law: StateSpace | None = None,
    identify: Rational | None = None,
    seconds: float = 2.0,
    settle_s: float = 1.0,
) -> Tuned:
    """Record a unit afresh, identify it and design for it; nothing of its truth is looked at.

    Args:
        bench: the unit, without a law.
        design: any design method; one with a setting `start` begins with `law`, others begin anew.
        band_hz: where the law is to be quiet; the record is densest there and above.
        law: what runs today.
        identify: how the response becomes a model; `Rational()` when absent.
        seconds: a period of the record, two of which are measured a stretch and actuator; four times as long far below
            the band.
        settle_s: before them.

    Returns:
        `Tuned`; put its law on by `commission`.

    Raises:
        InputError: a band beyond half the rate, an actuator that moves nothing.
    """
    rate = bench.rate_hz
    low, high = rising_band(WHO, band_hz, rate)
    settle = max(1, round(positive(WHO, "settle_s", settle_s, "s") * rate))
    first = max(1.0 / positive(WHO, "seconds", seconds, "s"), low / BELOW)
    top = TOP_SHARE * rate / 2
    edges = sorted({first, *(f for f in (FAR_BELOW * low, 2 * low, high) if first < f < top), top})
    far = int(edges[1] == FAR_BELOW * low)
    periods = [LONGER * seconds] * far + [seconds] * (len(edges) - 1 - far)
    method = _begun(design, law)
    spent: dict[str, float] = {}
    with task("tuning in place", 3) as progress:
        clock = time.process_time()
        passes = stretches(edges, periods, (PER_OCTAVE[:far] + PER_OCTAVE)[: len(periods)], rate)
        most = swings(WHO, bench.actuators)
        levels = np.where(np.isfinite(most), COMMAND_SHARE * most, 1.0)
        parts = [_recorded(bench, each, levels, settle) for each in passes]
        clock = _spent(spent, "record", clock)
        progress.advance(note="recorded")
        fit = (identify or Rational()).identify_response(_joined(parts, max(periods), bench), rate)
        clock = _spent(spent, "identify", clock)
        progress.advance(note=str(fit.status))
        found = method.design(_named(fit.model, bench))
        _spent(spent, "design", clock)
        progress.advance(note=str(found.status))
    return Tuned(found.controller, fit.model, found, float(fit.error[1]), spent)


def _begun(design: Any, law: StateSpace | None) -> Any:
    """Return a design that begins with a law, where it takes one."""
    if not hasattr(design, "design"):
        raise InputError(f"{WHO}: 'design' must be a design method, got {type(design).__name__}.")
    takes = is_dataclass(design) and any(f.name == "start" for f in fields(design))
    known: Any = design
    return replace(known, start=law) if takes and law is not None else design


def _recorded(bench: Bench, injection: Injection, most: FloatArray, settle: int) -> MeasuredResponse:
    levels = open_levels(bench, injection, READING_SHARE, settle, most)
    return measured_response(bench, injection, levels, settle)


def _joined(parts: list[MeasuredResponse], longest_s: float, bench: Bench) -> FrequencyResponse:
    f, G, variance = blended(parts, longest_s)
    return FrequencyResponse(
        f,
        G,
        variance=variance,
        estimator=f"sines at one actuator after the other, {NOISE_PERIODS} periods",
        actuators=bench.actuators,
        sensors=bench.sensors,
    )


def _named(model: StateSpace, bench: Bench) -> StateSpace:
    return StateSpace(model.A, model.B, model.C, model.D, model.rate_hz, bench.actuators, bench.sensors)


def _spent(spent: dict[str, float], name: str, since: float) -> float:
    now = time.process_time()
    spent[name] = now - since
    return now
