"""Spectra against closed forms and a known system."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.spectra import frf, psd
from ultraquiet.values import Record, StateSpace

RATE = 1000.0


@pytest.fixture
def plant():
    A = np.array([[0.9, 0.3], [-0.3, 0.9]]) * 0.95
    return StateSpace(A, [[1.0, 0.2], [0.0, 1.0]], [[0.5, 0.0], [0.1, 1.0]], [[0.0, 0.1], [0.0, 0.0]], rate_hz=RATE)


def test_white_noise_has_a_flat_density_of_the_right_height(rng):
    spectrum = psd(3.0 * rng.standard_normal((2, 2**17)), rate_hz=RATE, segment_samples=512)
    expected = 9.0 / (RATE / 2)
    inner = spectrum.values[:, 2:-2]
    print(f"mean {inner.mean() / expected:.4f}, scatter {inner.std() / expected:.4f} of the true density")
    # Half-overlapping Hann segments are correlated: they count as about 0.95 of as many independent ones (Welch 1967).
    assert inner.mean() == pytest.approx(expected, rel=6 / np.sqrt(2**17))
    assert np.abs(inner / expected - 1).max() < 6.5 / np.sqrt(0.9 * spectrum.averages)
    assert spectrum.asd**2 == pytest.approx(spectrum.values)
    assert spectrum.rms()[0] == pytest.approx(3.0, rel=0.02)
    assert spectrum.rms(0, 100)[0] == pytest.approx(3.0 * np.sqrt(0.2), rel=0.05)


def test_a_record_s_outputs_are_taken_with_its_rate(rng):
    y = rng.standard_normal((3, 4000))
    by_record = psd(Record(np.zeros((1, 4000)), y, RATE))
    assert np.array_equal(by_record.values, psd(y, rate_hz=RATE).values)
    assert "15 segments of 500 samples" in by_record.estimator


def test_frf_of_inputs_one_after_another(plant, rng):
    records = []
    for j in range(2):
        u = np.zeros((2, 2**16))
        u[j] = rng.standard_normal(2**16)
        y = plant.simulate(u) + 0.01 * rng.standard_normal((2, 2**16))
        records.append(Record(u, y, RATE, ["a", "b"], ["p", "q"]))
    g = frf(records[::-1], segment_samples=2048)
    assert [c.name for c in g.actuators] == ["b", "a"]
    truth = plant.frequency_response(g.f_hz)[:, ::-1]
    error = np.abs(g.values - truth).max() / np.abs(truth).max()
    print(f"largest error {error:.4f}, least coherence {g.coherence.min():.4f}, {g.estimator}")
    assert error < 0.03
    expected = np.abs(truth) ** 2 / (np.abs(truth) ** 2 + 0.01**2)
    off = np.abs(g.coherence - expected).max()
    print(f"coherence off by {off:.4f} at most")
    assert off < 0.15
    assert g.estimator.startswith("H1, 63 segments of 2048 samples, window hann")


def test_frf_of_inputs_together(plant, rng):
    u = rng.standard_normal((2, 2**17))
    g = frf(Record(u, plant.simulate(u), RATE), segment_samples=2048)
    truth = plant.frequency_response(g.f_hz)
    error = np.abs(g.values - truth).max() / np.abs(truth).max()
    print(f"largest error {error:.4f}")
    assert error < 0.03
    assert "multiple coherence" in g.estimator
    assert g.coherence.max() <= 1.0


def test_coherence_tells_the_share_of_noise(rng):
    u, noise = rng.standard_normal((2, 2**18))
    g = frf(Record([u], [u + noise], RATE), segment_samples=512)
    mean = g.coherence[0, 0, 3:-3].mean()
    print(f"mean coherence {mean:.4f}, 0.5 expected")
    assert mean == pytest.approx(0.5, abs=0.01)


def test_lines_without_power_are_left_out():
    n = np.arange(4096)
    u = np.cos(2 * np.pi * 64 * n / 1024) + np.cos(2 * np.pi * 200 * n / 1024)
    g = frf(Record([u], [2 * u], RATE), segment_samples=1024, window="boxcar")
    assert np.allclose(g.f_hz, np.array([64, 200]) * RATE / 1024)
    assert np.allclose(g.values, 2.0)


def bad_cases():
    quiet, loud = np.zeros((1, 100)), np.ones((1, 100))
    rising = np.arange(100.0)[None]
    moving = Record(rising, rising, RATE)
    return [
        (lambda: psd(loud), InputError, "needs 'rate_hz'"),
        (lambda: psd(loud * np.nan, rate_hz=1.0), InputError, "NaN"),
        (lambda: psd(loud, rate_hz=1.0, segment_samples=200), InputError, "does not fit into 100 samples"),
        (lambda: psd(loud, rate_hz=1.0, overlap=1.0), InputError, "between 0 and 0.95"),
        (lambda: frf([]), InputError, "at least one record"),
        (lambda: frf(Record(quiet, rising, RATE)), InputError, "excite at least one input"),
        (lambda: frf(Record(rising, loud, RATE)), InputError, "output 'output 1' never moves"),
        (lambda: psd(loud, rate_hz=1.0), InputError, "channel 'channel 1' never moves"),
        (lambda: frf([moving, Record(rising, rising, 2.0)]), RateError, "sampled at 2 Hz"),
        (lambda: frf([moving, Record(rising, [*rising, *rising], RATE)]), InputError, "same actuators and sensors"),
        (
            lambda: frf(Record(np.random.default_rng(0).normal(size=(3, 100)), rising, RATE), segment_samples=60),
            InputError,
            "cannot separate 3 inputs",
        ),
    ]


@pytest.mark.parametrize("case", bad_cases(), ids=lambda c: c[2])
def test_bad_input_is_refused(case):
    call, kind, words = case
    with pytest.raises(kind, match=words):
        call()
