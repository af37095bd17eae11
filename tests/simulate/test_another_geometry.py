"""The packaged study's law on hexapods it was never tuned on: recorded, identified, designed and measured the same."""

import time

import numpy as np
import pytest
from other_hexapod import OtherHexapod

import ultraquiet as uq
from ultraquiet.design.result import refused
from ultraquiet.identify import Rational
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate import measure_sensitivity, tune_in_place

BAND_HZ, UNITS = (10.0, 100.0), ("ground", "flight")
QUIET_DB, PEAK_DB = 18.0, 6.5
BESIDE_DB = 1.0  # by which what is measured may fall short of what the models say


class RecordedOnly:
    """A design that designs nothing: what is wanted is the model."""

    def design(self, plant):
        return refused("a model is wanted, and no law")


def test_another_hexapod_is_another_plant_and_the_same_one_for_a_seed():
    f = np.geomspace(1.0, 1500.0, 40)
    own, one, again, other = (
        bench.linear_model().frequency_response(f)
        for bench in (uq.bench.Hexapod(), *(OtherHexapod(geometry_seed=seed) for seed in (1, 1, 2)))
    )
    assert np.array_equal(one, again)
    assert np.abs(OtherHexapod(geometry_seed=1).run(np.zeros((6, 20))).outputs).max() > 0
    for a, b in ((own, one), (one, other)):
        assert np.linalg.norm(a - b) > 0.2 * np.linalg.norm(a)


def designed(seed, geometry):
    """The benches of both units, and the study's law for what was identified on them."""
    benches = [OtherHexapod(unit=unit, seed=seed, hysteresis=True, geometry_seed=geometry) for unit in UNITS]
    identify = Rational(zeros_at_dc=1)
    models = [tune_in_place(bench, RecordedOnly(), BAND_HZ, identify=identify).model for bench in benches]
    began = time.process_time()
    result = packaged_study("suite").controllers["quiet"].design.make("design").design(models)
    print(f"{time.process_time() - began:.1f} s of the processor: {result.status}", flush=True)
    return benches, result


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "geometry",
    # a stack's resonance a half as high again, at 1.5 kHz, costs 3 to 6 dB, for the study's law stands modes 3 % off:
    # of eleven geometries drawn, 7001 to 7011, eight reach 18 dB, the others 16.5 to 17.8
    [pytest.param(None, marks=pytest.mark.draws(false_alarm=0.3)), 7012],
)
def test_the_same_study_quietens_another_hexapod(seed, geometry):
    """Of 7012 the search once ended at half a decibel."""
    benches, result = designed(seed, 7000 + seed if geometry is None else geometry)
    assert result.controller is not None
    found = {}
    for unit, bench in zip(UNITS, benches, strict=True):
        read = measure_sensitivity(bench, result.controller)
        truth = uq.analyse.band_attenuation(bench.linear_model(), result.controller, BAND_HZ)[0]
        found[unit] = read.worst_in_band_db(*BAND_HZ), read.peak_amplification_db()
        print(f"{unit}: {found[unit][0]:.2f} dB at {found[unit][1]:.2f} dB of peak; {truth:.2f} dB on the truth")
    assert result.status.ok, result.status
    for quiet, peak in found.values():
        assert quiet >= result.details["attenuation_db"] - BESIDE_DB
        assert quiet >= QUIET_DB
        assert peak <= PEAK_DB


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_where_no_law_is_quiet_on_all_plants_drawn_the_search_goes_back_to_the_best_before():
    """Gone on with from the law that failed alone, this one ended at 0.1 dB."""
    _, result = designed(529043948, 7000 + 529043948)
    assert result.status.ok, result.status
    assert result.details["attenuation_db"] >= 12.0
