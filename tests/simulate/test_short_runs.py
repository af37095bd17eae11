"""Runs of a few samples: refused with what would do, or measured as far as they reach."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.simulate import attenuation, noise_reduction, step_reduction
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain


def slow(ny, nu, unit=1.0):
    """A bench of one sample a second and a law for it."""
    B = 0.1 * unit * np.ones((ny, nu))
    plant = StateSpace(0.5 * np.eye(ny), B, np.eye(ny), np.zeros((ny, nu)), rate_hz=1.0)
    return uq.bench.LinearBench(plant), gain(-0.1 / unit * np.ones((nu, ny)), 1.0)


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_runs_too_short_for_noise_a_step_or_a_tone_say_how_long_would_do(ny, nu, unit):
    bench, law = slow(ny, nu, unit)
    for short, said in ((0.5, "0 samples; it takes 3 or more, 3 s here"), (1.0, "1 sample;"), (2.9, "2 samples;")):
        with pytest.raises(InputError, match=f"noise_reduction: 'duration_s' = {short:g} s holds {said}"):
            noise_reduction(bench, law, (0.1, 0.4), duration_s=short)
    for short, said in ((0.5, "0 samples; it takes 2 or more, 2 s here"), (1.0, "1 sample;")):
        with pytest.raises(InputError, match=f"step_reduction: 'duration_s' = {short:g} s holds {said}"):
            step_reduction(bench, law, duration_s=short)
    with pytest.raises(InputError, match="attenuation: 'duration_s' = 4 s holds 4 samples; it takes 5 or more, 5 s"):
        attenuation(bench, law, (0.4,), duration_s=4.0)
    assert np.isfinite(noise_reduction(bench, law, (0.1, 0.4), duration_s=3.0).reduction_db).all()
    assert np.isfinite(step_reduction(bench, law, duration_s=2.0).closed_peak).all()
    assert np.isfinite(attenuation(bench, law, (0.45,), duration_s=5.0).reduction_db).all()
