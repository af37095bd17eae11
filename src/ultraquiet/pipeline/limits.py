"""The stage that says what no controller can reach, and how far each design is from it."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

from ultraquiet import limits
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.threads import in_threads
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.facts.limits import BandLimit, DesignLimit, LimitFacts, NoDistance, RefusedBand
from ultraquiet.values import StateSpace

# The price at which bands are compared: gain margin 2 in every direction, and what a strut takes of a sensor's noise.
PEAK_DB, CONTROL_GAIN = 6.0, 1000.0
BROADEST_HZ = (5.0, 100.0)
# Functions of the search: fewer cost sharpness, and on an identified 6x6 plant half as many often certify nothing.
BASIS = 60


def bounded(plant: StateSpace, laws: Mapping[str, StateSpace], band_hz: tuple[float, float]) -> Outcome[LimitFacts]:
    """Return limits of the plant's weakest direction over both bands, and each design beside its own.

    What has no limit, an unstable plant of several channels for instance, says so in its `status`.
    """
    bands = [BROADEST_HZ, *([band_hz] if band_hz != BROADEST_HZ else [])]
    jobs: dict[Hashable, Callable[[], Any]] = {band: partial(_of_band, plant, band) for band in bands}
    jobs |= {name: partial(_of_design, plant, law, band_hz) for name, law in laws.items()}
    found = in_threads("limits", lambda name: jobs[name](), list(jobs))
    designs = {name: found[name] for name in laws}
    return Outcome(LimitFacts(bands=tuple(found[band] for band in bands), designs=designs))


def _of_band(plant: StateSpace, band_hz: tuple[float, float]) -> BandLimit | RefusedBand:
    try:
        weakest = limits.principal_directions(plant, band_hz)[:, :1]
        price = {"control_gain": CONTROL_GAIN, "directions": weakest, "basis": BASIS}
        limit = limits.by_direction(plant, band_hz, PEAK_DB, **price)[0].limit
    except UltraquietError as error:
        return RefusedBand(band_hz=band_hz, peak_db=PEAK_DB, control_gain=CONTROL_GAIN, status=f"refused: {error}")
    return BandLimit(
        band_hz=band_hz,
        peak_db=PEAK_DB,
        control_gain=CONTROL_GAIN,
        attenuation_db=limit.attenuation_db,
        bound_db=limit.bound_db,
        binding=limit.binding,
        status=str(limit.status),
    )


def _of_design(plant: StateSpace, law: StateSpace, band_hz: tuple[float, float]) -> DesignLimit | NoDistance:
    try:
        distance = limits.distance(plant, law, band_hz, basis=BASIS)
    except UltraquietError as error:
        return NoDistance(status=f"refused: {error}")
    return DesignLimit(
        band_hz=band_hz,
        attenuation_db=distance.attenuation_db,
        peak_db=distance.peak_db,
        control_gain=distance.control_gain,
        limit_db=distance.attenuation_db + distance.left_db,
        left_db=distance.left_db,
        alone_db=distance.limit.attenuation_db if distance.limit else None,
        status=str(distance.status),
    )
