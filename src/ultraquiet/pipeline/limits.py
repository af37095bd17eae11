"""The stage that says what no controller can reach, and how far each design is from it."""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from ultraquiet import limits
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.progress import task
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.values import StateSpace

# The price at which bands are compared: gain margin 2 in every direction, and what a strut takes of a sensor's noise.
PEAK_DB, CONTROL_GAIN = 6.0, 1000.0
BROADEST_HZ = (5.0, 100.0)
# Functions of the search: fewer cost sharpness, and on an identified 6x6 plant half as many often certify nothing.
BASIS = 60


def bounded(plant: StateSpace, laws: Mapping[str, StateSpace], band_hz: tuple[float, float]) -> Outcome:
    """Return limits of the plant's weakest direction over both bands, and each design beside its own.

    What has no limit, an unstable plant of several channels for instance, says so in its `status`.
    """
    bands = [BROADEST_HZ, *([band_hz] if band_hz != BROADEST_HZ else [])]
    jobs = [partial(_of_band, plant, band) for band in bands]
    jobs += [partial(_of_design, plant, law, band_hz) for law in laws.values()]
    with task("limits", len(jobs)) as progress, ThreadPoolExecutor(os.cpu_count()) as pool:
        found = []
        for facts in pool.map(lambda job: job(), jobs):
            found.append(facts)
            progress.advance(note=facts["status"])
    told, designs = found[: len(bands)], dict(zip(laws, found[len(bands) :], strict=True))
    return Outcome({}, {"bands": told, "designs": designs})


def _of_band(plant: StateSpace, band_hz: tuple[float, float]) -> dict[str, Any]:
    facts = {"band_hz": band_hz, "peak_db": PEAK_DB, "control_gain": CONTROL_GAIN}
    try:
        weakest = limits.principal_directions(plant, band_hz)[:, :1]
        price = {"control_gain": CONTROL_GAIN, "directions": weakest, "basis": BASIS}
        limit = limits.by_direction(plant, band_hz, PEAK_DB, **price)[0].limit
    except UltraquietError as error:
        return {**facts, "status": f"refused: {error}"}
    return {
        **facts,
        "attenuation_db": limit.attenuation_db,
        "bound_db": limit.bound_db,
        "binding": dict(limit.binding),
        "status": str(limit.status),
    }


def _of_design(plant: StateSpace, law: StateSpace, band_hz: tuple[float, float]) -> dict[str, Any]:
    try:
        found = limits.distance(plant, law, band_hz, basis=BASIS)
    except UltraquietError as error:
        return {"status": f"refused: {error}"}
    return {
        "band_hz": band_hz,
        "attenuation_db": found.attenuation_db,
        "peak_db": found.peak_db,
        "control_gain": found.control_gain,
        "limit_db": found.attenuation_db + found.left_db,
        "left_db": found.left_db,
        "alone_db": found.limit.attenuation_db if found.limit else None,
        "status": str(found.status),
    }
