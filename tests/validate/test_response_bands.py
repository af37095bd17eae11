"""Confidence bands: they hold what they promise, and the estimate behind them is as good as can be."""

import numpy as np
import pytest
from campaigns import campaign, pooled
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.validate.gradient import coefficients, response_gradient, with_coefficients

RATE_HZ = 100.0
MODEL = uq.PolynomialModel(
    [[0, 0.4, 0.2], [0, 0, 0.3]], [[1, -1.5, 0.8], [1, -0.6]], RATE_HZ, [1, -0.3], [1, 0.4], [1, -0.7]
)


def judged(rng, draws):
    """Print and return the worst mean squared error over the bound, and coverage with standard error of three bands."""
    found = campaign(rng, draws)
    ratio = float(np.mean(found.squared / found.bound))
    shares = {k: pooled(getattr(found, k)) for k in ("gain_held", "phase_held", "both_held")}
    text = ", ".join(f"{k} {s:.1f} +- {e:.1f} %" for k, (s, e) in shares.items())
    print(f"\n{draws} records: squared error {ratio:.2f} of the Cramer-Rao bound; {text}; ok {found.ok.mean():.1%}")
    return ratio, shares


@pytest.mark.slow
def test_bands_cover_and_the_error_is_near_the_bound(rng):
    ratio, shares = judged(rng, 600)
    assert ratio < 1.3
    for share, error in shares.values():
        assert 93 - 2 * error < share < 97 + 2 * error


@pytest.mark.slow
def test_bands_cover_on_sixty_records(rng):
    ratio, shares = judged(rng, 60)
    assert ratio < 1.3 * 1.25  # the mean over 60 records scatters by some 5 %
    for share, error in shares.values():
        assert 93 - 3 * error < share < 97 + 3 * error


def test_gradient_is_the_difference_quotient():
    f_hz = np.array([0.0, 0.5, 7.0, 31.0])
    theta = coefficients(MODEL)
    found = response_gradient(MODEL, f_hz)
    step = 1e-6
    for k in range(theta.size):
        up, down = (with_coefficients(MODEL, theta + s * step * np.eye(theta.size)[k]) for s in (1, -1))
        slope = (up.frequency_response(f_hz) - down.frequency_response(f_hz))[0] / (2 * step)
        assert found[:, k] == pytest.approx(slope, rel=1e-6, abs=1e-7)


def lag_record(rng, noise=0.3):
    u, e = rng.standard_normal((2, 1500))
    return uq.Record(u, lfilter([0, 0.5], [1, -0.8], u) + noise * e, RATE_HZ)


def test_sampled_bands_agree_with_linearised_ones_where_they_are_narrow(rng):
    result = uq.identify.OutputError(order=1).identify(lag_record(rng))
    line, drawn = (uq.validate.response_band(result, [1.0, 10.0], method=m) for m in ("linearised", "sampled"))
    widths = (drawn.gain_high_db - drawn.gain_low_db) / (line.gain_high_db - line.gain_low_db)
    print(f"\nsampled over linearised width: {widths.ravel().round(3)}")
    assert widths == pytest.approx(1.0, abs=0.25)
    assert line.response().variance == pytest.approx(line.variance)
    assert np.all(line.distance(line.values) == pytest.approx(0.0))


def test_bands_of_a_matrix_from_one_record_per_actuator(rng):
    records = []
    for k in range(2):
        u = np.zeros((2, 1500))
        u[k] = rng.standard_normal(1500)
        y = np.stack([lfilter([0, 0.5], [1, -0.8], u[k]), lfilter([0, -0.2], [1, -0.5], u[k])])
        records.append(uq.Record(u, y + 0.1 * rng.standard_normal(y.shape), RATE_HZ))
    result = uq.identify.identify_matrix(uq.identify.BoxJenkins(order=1), records)
    band = uq.validate.response_band(result, [1.0, 5.0, 20.0])
    assert band.values.shape == band.gain_db.shape == (2, 2, 3)
    assert band.values == pytest.approx(result.model.frequency_response([1.0, 5.0, 20.0]))


def test_refusals(rng):
    record = lag_record(rng)
    result = uq.identify.OutputError(order=1).identify(record)
    with pytest.raises(InputError, match=r"'level' must"):
        uq.validate.response_band(result, [1.0], level=1.0)
    with pytest.raises(InputError, match=r"'method' must be one of|'method' must be"):
        uq.validate.response_band(result, [1.0], method="guess")
    with pytest.raises(InputError, match=r"no band: .* take refine=True"):
        uq.validate.response_band(uq.identify.Subspace(order=2, horizon=10).identify(record), [1.0])
