"""Readings at a sensor's limits are taken for what they are."""

import numpy as np
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
