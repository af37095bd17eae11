"""The stage that says what no controller can reach, and how far each design is from it."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import numpy as np

from ultraquiet import limits
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.shown.line import counted
from ultraquiet._base.threads import in_threads
from ultraquiet.analyse import singular_values
from ultraquiet.limits.by_direction import tightened
from ultraquiet.limits.directions import moved
from ultraquiet.pipeline.facts.limits import BandLimit, DesignLimit, LimitFacts, NoDistance, RefusedBand
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.study import Band, LimitsTable
from ultraquiet.values import StateSpace, StatusWord

# Without a stated price the control may have so many times the gain that inverting the plant's weakest direction takes.
INVERSIONS, LINES = 10.0, 60
# Functions of the search: fewer cost sharpness, and on an identified 6x6 plant half as many often certify nothing.
BASIS = 60
MORE = 90  # where a law's price is so high that these certify nothing


def stage(
    cache: Cache, settings: LimitsTable, plant: StateSpace, laws: Mapping[str, StateSpace], band_hz: Band
) -> Outcome[LimitFacts]:
    """Return what `bounded` finds, from the folder where it was found before."""
    key = [plant.hash, band_hz, settings, {name: law.hash for name, law in laws.items()}]
    return cache.stage("limits", "models", key, partial(bounded, plant, laws, band_hz, settings), LimitFacts)


def bounded(
    plant: StateSpace, laws: Mapping[str, StateSpace], band_hz: Band, settings: LimitsTable
) -> Outcome[LimitFacts]:
    """Return limits of the plant's weakest direction over bands, and each design beside its own.

    What has no limit, an unstable plant of several channels for instance, says so in its `status`.
    """
    bands = settings.bands_hz or [band_hz]
    price, off = (settings.peak_db, settings.control_gain or _inverting(plant, band_hz)), settings.uncertainty
    jobs: dict[Hashable, Callable[[], Any]] = {band: partial(_of_band, plant, band, *price, off) for band in bands}
    jobs |= {name: partial(beside_its_limit, plant, law, band_hz, off) for name, law in laws.items()}
    found = in_threads("limits", lambda name: jobs[name](), list(jobs))
    designs = {name: found[name] for name in laws}
    return Outcome({}, LimitFacts(bands=tuple(found[band] for band in bands), designs=designs))


def _inverting(plant: StateSpace, band_hz: Band) -> float:
    """Return the gain of control that is allowed where the study states none."""
    weakest = singular_values(plant, np.geomspace(*band_hz, LINES))[-1]
    heard = weakest[weakest > 0]
    return INVERSIONS / float(np.median(heard)) if heard.size else 1.0


def _of_band(
    plant: StateSpace, band_hz: Band, peak_db: float, control_gain: float, uncertainty: float
) -> BandLimit | RefusedBand:
    try:
        weakest = moved(plant, band_hz)[:, :1]
        price = {"control_gain": control_gain, "directions": weakest, "basis": BASIS}
        limit = limits.by_direction(plant, band_hz, peak_db, **price)[0].limit
    except UltraquietError as error:
        return RefusedBand(band_hz=band_hz, peak_db=peak_db, control_gain=control_gain, status=f"refused: {error}")
    robust, said = None, None
    try:
        if uncertainty:
            robust = limits.by_direction(plant, band_hz, peak_db, **price, uncertainty=uncertainty)[0].limit
            robust = tightened(robust, limit)
            said = str(robust.status)
    except UltraquietError as error:
        said = f"refused: {error}"
    return BandLimit(
        band_hz=band_hz,
        peak_db=peak_db,
        control_gain=control_gain,
        attenuation_db=limit.attenuation_db,
        bound_db=limit.bound_db,
        binding=limit.binding,
        status=f"{limit.status}{_out_of_reach(plant)}",
        uncertainty=uncertainty,
        robust_attenuation_db=robust.attenuation_db if robust else None,
        robust_bound_db=robust.bound_db if robust else None,
        robust_status=said,
    )


def _out_of_reach(plant: StateSpace) -> str:
    """Return what no limit speaks of: directions that a plant with more outputs than inputs cannot move."""
    ny, nu = plant.D.shape
    moved_by = f"{counted(nu, 'input')} {'moves' if nu == 1 else 'move'}"
    return f" {moved_by} {nu} of {ny} directions at a time; in the others nothing is reached." * (ny > nu)


def beside_its_limit(
    plant: StateSpace, law: StateSpace, band_hz: Band, uncertainty: float = 0.0
) -> DesignLimit | NoDistance:
    """Return a law beside what any could do at its peak and gain over a band (Hz); without one, why in `status`.

    With a relative error of the plant, beside what any could do on every such plant too.
    """
    try:
        distance = limits.distance(plant, law, band_hz, basis=BASIS, uncertainty=uncertainty or None)
        if distance.status.word is StatusWord.NOT_CERTIFIED:
            distance = limits.distance(plant, law, band_hz, basis=MORE, uncertainty=uncertainty or None)
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
        status=f"{distance.status}{_out_of_reach(plant)}",
        uncertainty=uncertainty,
        robust_alone_db=distance.robust.attenuation_db if distance.robust else None,
        robust_limit_db=distance.robust.bound_db if distance.robust else None,
    )
