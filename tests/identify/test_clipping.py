"""Readings at a sensor's limits are taken for what they are."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq

SAMPLES = 4096


def gains(rng, repair):
    """Worst gain error in dB of a resonance whose strongest readings are cut, over the identified band."""
    u = rng.standard_normal(SAMPLES)
    b, f = [0.0, 0.1], [1.0, -1.9, 0.93]
    y = lfilter(b, f, u)
    y += lfilter([1.0], [1.0, -0.6], 0.01 * y.std() * rng.standard_normal(SAMPLES))
    limit = 1.3 * y.std()
    record = uq.Record(u, np.clip(y, -limit, limit), 1000.0, sensors=[uq.Channel("g", "V", -limit, limit)])
    result = uq.identify.BoxJenkins(order=2, repair=repair).identify(record)
    truth = uq.PolynomialModel([b], [f], 1000.0)
    agreement = uq.validate.bode_agreement(truth, result.model, (5, 300))
    return agreement.worst_gain_db[0, 0], record.clipped()[0], result


def test_repair_restores_the_gain(seed):
    kept, clipped, _ = gains(np.random.default_rng(seed), repair=False)
    mended, _, result = gains(np.random.default_rng(seed), repair=True)
    print(f"\n{clipped} of {SAMPLES} readings cut: gain off by {kept:.2f} dB as read, {mended:.2f} dB repaired")
    assert result.details["repaired"] == (clipped,)
    assert mended < 0.3 * kept
    assert mended < 0.5


@pytest.mark.gate("1-1-memory", "5-3-disk")
@pytest.mark.parametrize("stored", [False, True], ids=["memory", "disk"])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_a_subspace_that_repairs_nothing_praises_no_cut_output(stored, nu, ny, rng, tmp_path):
    A = np.array([[0.93, 0.2], [-0.2, 0.93]])
    plant = uq.StateSpace(A, rng.standard_normal((2, nu)), rng.standard_normal((ny, 2)), np.zeros((ny, nu)), 100.0)
    u = 1e3 * rng.standard_normal((nu, 3000))
    y = 1e-9 * plant.simulate(u)
    y = y + 0.05 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    limit = 1.2 * y[-1].std()
    sensors = [uq.Channel(f"s{i}", "m") for i in range(ny - 1)] + [uq.Channel("cut", "m", -limit, limit)]
    y[-1] = y[-1].clip(-limit, limit)
    record = uq.Record(u, y, 100.0, None, sensors)
    methods = [uq.identify.Subspace(order=2), uq.identify.Subspace(order=2, refine=True)]
    if stored:
        with uq.files.LongWriter(tmp_path / "cut.h5", 100.0, record.actuators, record.sensors, "float64") as writer:
            writer.append(u, y)
    for method in methods if stored else [*methods, uq.identify.PredictorSubspace(order=2)]:
        found = method.identify(uq.files.LongRecord(tmp_path / "cut.h5") if stored else record)
        print(found.statuses[-1])
        assert found.statuses[-1].word == "not white"
        assert f"{record.clipped()[-1]} readings of 'cut' stand at its limits" in found.statuses[-1].sentence
        assert "'output-error'" in found.statuses[-1].sentence
        assert not any("limits" in status.sentence for status in found.statuses[:-1])
