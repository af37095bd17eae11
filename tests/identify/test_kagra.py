"""A model from a measured frequency response file alone: the beam splitter suspension of KAGRA."""

from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq

FOLDER = Path(__file__).parents[1] / "data" / "kagra"
AVERAGES = 5
# Below this the suspension's slowest modes are not resolved by 8 mHz.
LOWEST_HZ = 0.02
# Where neither record is coherent there is nothing to repeat.
COHERENT = 0.6


def record(name):
    """One of two repeats; the program that wrote them forms E[u y*]."""
    held = uq.files.read_frf(FOLDER / f"BS_TML_exc_20200730{name}_frf.npz", conjugated=True)
    known = uq.spectra.with_coherence_variance(held, AVERAGES)
    kept = known.f_hz > LOWEST_HZ
    return uq.FrequencyResponse(
        known.f_hz[kept],
        known.values[:, :, kept],
        known.coherence[:, :, kept],
        variance=known.variance[:, :, kept],
        sensors=[c.name.split("-BS_")[1] for c in known.sensors],
    )


def apart(first, second, weight):
    """Difference of two responses relative to the second, root mean square over coherent lines, per sensor."""
    share = np.abs(first - second)[:, 0] ** 2 / np.abs(second[:, 0]) ** 2
    return np.sqrt(np.sum(weight * share, axis=1) / np.sum(weight, axis=1))


@pytest.mark.slow
def test_a_fit_to_one_record_meets_the_other_better_than_the_first_record_does():
    a, b = record("a"), record("b")
    fit = uq.identify.WeightedRational(floor=0.1, highest_order=20).identify_response(a)
    coherence = np.minimum(a.coherence, b.coherence)[:, 0]
    weight = np.where(coherence > COHERENT, coherence, 0.0)
    told = np.count_nonzero(weight, axis=1) > 50
    a_values, b_values, weight = a.values[told], b.values[told], weight[told]
    ours = apart(fit.frequency_response(b.f_hz)[told], b_values, weight)
    theirs = apart(a_values, b_values, weight)
    names = [c.name for c, t in zip(a.sensors, told, strict=True) if t]
    print(f"\norder {fit.order}, {fit.model.states} states, {fit.status}")
    for name, own, repeat in zip(names, ours, theirs, strict=True):
        print(f"{name:<22} model of a against b {own:.3f}, record a against b {repeat:.3f}")
    modes = np.sort(np.abs(fit.model.poles()[fit.model.poles().imag > 0])) / (2 * np.pi)
    print(f"modes: {', '.join(f'{m:.3f}' for m in modes)} Hz")
    assert fit.model.is_stable()
    assert fit.model.rate_hz is None
    assert np.all(ours[-3:] < theirs[-3:])
    assert np.median(ours / theirs) < 0.8
