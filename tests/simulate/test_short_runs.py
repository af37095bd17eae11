"""Few samples, a single line, a loop without states: refused with what would do, or measured as far as they reach."""

import dataclasses

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.simulate import attenuation, check_stability, measure_sensitivity, noise_reduction, step_reduction
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


def drawn(rng, ny, nu, unit):
    """A bench whose channels are all reached, and a law for it."""
    B = 0.1 * unit * (np.eye(ny, nu) + 0.1 * rng.standard_normal((ny, nu)))
    plant = StateSpace(0.9 * np.eye(ny), B, np.eye(ny), np.zeros((ny, nu)), rate_hz=1000.0)
    return plant, gain(-0.5 / unit * np.eye(nu, ny), 1000.0)


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_a_sensitivity_of_one_line_has_a_broadband_figure_and_a_mean(ny, nu, unit, rng):
    plant, law = drawn(rng, ny, nu, unit)
    found = measure_sensitivity(uq.bench.LinearBench(plant), law, f_hz=[50.0])
    opened, closed = (np.sum(np.abs(y[:, :, 0]) ** 2, axis=1) for y in (found.opened, found.closed))
    assert found.broadband_db(10.0, 100.0) == pytest.approx(10 * np.log10((opened / closed).min()))
    sizes = np.linalg.svd(found.S.values[:, :, 0], compute_uv=False)[: min(ny, nu)]
    assert found.mean_log_db() == pytest.approx(20 * np.log10(sizes).mean())


def test_a_sensor_that_hears_nothing_has_no_part_in_a_broadband_figure():
    """Of two places the second moves by nothing; nor does a bench whose only place does not."""
    law = gain(-0.5 * np.eye(2), 1000.0)
    moved = StateSpace(0.9 * np.eye(2), 0.1 * np.eye(2), np.diag([1.0, 0.0]), np.zeros((2, 2)), rate_hz=1000.0)
    found = measure_sensitivity(uq.bench.LinearBench(moved), law, f_hz=[20.0, 50.0])
    opened, closed = (np.sum(np.abs(y[0]) ** 2) for y in (found.opened, found.closed))
    assert found.broadband_db(10.0, 100.0) == pytest.approx(10 * np.log10(opened / closed))
    still = dataclasses.replace(found, opened=0 * found.opened, closed=0 * found.closed)
    assert still.broadband_db(10.0, 100.0) == 0.0


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_a_model_without_states_beside_a_loop_forgets_at_once(ny, nu, unit, rng):
    plant, law = drawn(rng, ny, nu, unit)
    static = gain(unit * np.eye(ny, nu), 1000.0)
    for bench in (plant, static):
        check = check_stability(uq.bench.LinearBench(bench), law, model=static)
        assert check.status.ok
        assert check.model_growth_per_s < -1e5
        assert check.model_growth_hz == 0.0
