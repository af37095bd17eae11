"""The broad band of 5-100 Hz: what the packaged law leaves of its power, and every direction with better geophones."""

import pytest
from test_another_geometry import UNITS, RecordedOnly

import ultraquiet as uq
from ultraquiet.design import PeakBounded
from ultraquiet.identify import Rational
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate import measure_sensitivity, tune_in_place

BROAD_HZ, QUIET_DB, PEAK_DB = (5.0, 100.0), 20.0, 6.0
CORNER_HZ = 4.5
# A broader band with gain down to 5 Hz takes a law of more states; on two units, whose tolerances are not asked for.
BROAD = PeakBounded(
    band_hz=BROAD_HZ, structure="repeated", states=20, peak_db=4.9, control_limit=2500.0, steps=60, draws=0
)


def recorded(benches):
    return [tune_in_place(bench, RecordedOnly(), BROAD_HZ, identify=Rational(zeros_at_dc=1)).model for bench in benches]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_power_over_the_broad_band_with_the_bench_as_it_is(seed):
    benches = [uq.bench.Hexapod(unit=unit, seed=seed, hysteresis=True) for unit in UNITS]
    law = packaged_study("suite").controllers["quiet"].design.make("design").design(recorded(benches)).controller
    for bench in benches:
        power = measure_sensitivity(bench, law).broadband_db(*BROAD_HZ)
        print(f"{bench.unit}: power over 5-100 Hz {power:.2f} dB less", flush=True)
        assert power >= QUIET_DB


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_direction_of_the_broad_band_with_better_geophones(seed):
    benches = [uq.bench.Hexapod(unit=unit, seed=seed, hysteresis=True, geophone_hz=CORNER_HZ) for unit in UNITS]
    result = BROAD.design(recorded(benches))
    print(result.status)
    assert result.status.ok, result.status
    found = []
    for bench in benches:
        read = measure_sensitivity(bench, result.controller)
        found.append((read.worst_in_band_db(*BROAD_HZ), read.peak_amplification_db()))
        print(f"{bench.unit}: {found[-1][0]:.2f} dB at {found[-1][1]:.2f} dB of peak", flush=True)
    assert min(quiet for quiet, _ in found) >= QUIET_DB
    assert max(peak for _, peak in found) <= PEAK_DB
