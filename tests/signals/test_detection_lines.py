"""Multisines with lines left out for the detection of odd distortion."""

import numpy as np
import pytest

import ultraquiet as uq


def test_one_line_of_each_group_is_left_out_for_all_realisations(seed):
    full = uq.signals.Multisine(start_hz=2, stop_hz=150, period_samples=7000, odd=True)
    signal = uq.signals.Multisine(
        start_hz=2, stop_hz=150, period_samples=7000, odd=True, detection_group=4, detection_seed=seed
    )
    kept, every = signal.harmonics(3500.0), full.harmonics(3500.0)
    missing = np.setdiff1d(every, kept)
    assert missing.size == every.size // 4
    assert np.array_equal(np.searchsorted(every, missing) // 4, np.arange(missing.size))
    for realisation in (seed, seed + 1):
        power = np.abs(np.fft.rfft(signal.generate(7000, 3500.0, realisation)))
        assert np.array_equal(np.flatnonzero(power > 1e-6 * power.max()), kept)


def test_refusals():
    with pytest.raises(uq.errors.InputError, match="detection_group"):
        uq.signals.Multisine(detection_group=1)
    with pytest.raises(uq.errors.InputError, match="inputs"):
        uq.signals.orthogonal_multisines(uq.signals.Multisine(), inputs=0, samples=4096, rate_hz=3500.0)
