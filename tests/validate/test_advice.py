"""Advice: each fault is named, and a good record hears nothing."""

from collections import Counter

import numpy as np
import pytest
from campaigns import draw
from scipy.signal import lfilter

import ultraquiet as uq

DRAWS = 8


def heard(rng, spoil, method, draws=DRAWS, name="suite_rate"):
    """Count what is said about spoilt records of a truth."""
    count = Counter()
    for _ in range(draws):
        record = spoil(draw(name, rng), rng)
        result = method.identify(record)
        said = uq.validate.advise(record, result.model, result.covariance)
        count.update({x.about for x in said} or {"nothing"})
    return count


def with_outputs(drawn, y):
    return uq.Record(drawn.record.inputs, y, drawn.record.rate_hz)


def as_it_is(drawn, rng):
    return drawn.record


def cut(drawn, rng):
    limit = np.quantile(np.abs(drawn.record.outputs), 0.9)
    return with_outputs(drawn, np.clip(drawn.record.outputs, -limit, limit))


def drifting(drawn, rng):
    return with_outputs(drawn, drawn.record.outputs + np.linspace(0, 3, drawn.record.samples))


def far_off(drawn, rng):
    return with_outputs(drawn, drawn.record.outputs + 20)


def louder(drawn, rng):
    m = drawn.model
    e = np.sqrt(m.noise_variance) * rng.standard_normal(drawn.record.samples)
    e[2500:] *= 2
    return with_outputs(drawn, drawn.clean + lfilter(m.c, m.d, e))


def unheard(drawn, rng):
    # everything below 200 Hz is taken out of the input: the plant's modes at 12 and 55 Hz are not excited
    from scipy.signal import butter, sosfilt

    u = sosfilt(butter(8, 200, "highpass", fs=3500, output="sos"), drawn.record.inputs[0])
    m = drawn.model
    y = lfilter(m.b[0], m.f[0], u) + drawn.record.outputs[0] - drawn.clean
    return uq.Record(u, y, 3500.0)


def short(drawn, rng):
    return drawn.record.part(0, 600)


BJ = uq.identify.BoxJenkins
FAULTS = {
    "clipping": (cut, BJ(order=5)),
    "trend": (drifting, BJ(order=5)),
    "offset": (far_off, BJ(order=5)),
    "stationarity": (louder, BJ(order=5)),
    "excitation": (unheard, BJ(order=3)),
    "resolution": (short, BJ(order=5)),
    "order too low": (as_it_is, BJ(order=3)),
    "order too high": (as_it_is, BJ(order=6)),
}


def each_fault():
    """What order 3 leaves of an order-5 truth is heard in 432 of 496 records: in 4 of 8 or fewer once in 80 draws."""
    weak = pytest.mark.draws(false_alarm=0.02)
    return [pytest.param(about, marks=weak if about == "order too low" else ()) for about in FAULTS]


@pytest.mark.gate("order too low", "order too high", "offset", "resolution")
@pytest.mark.parametrize("about", each_fault())
def test_a_fault_is_named(about, rng):
    count = heard(rng, *FAULTS[about])
    print(f"\n{about}: named in {count[about]} of {DRAWS}; heard {dict(count)}")
    assert count[about] >= DRAWS - 3


@pytest.mark.slow
def test_a_delay_set_wrongly_is_named(rng):
    long = heard(rng, as_it_is, BJ(order=5, delay=4))
    brief = heard(rng, as_it_is, BJ(order=5, b_order=6, delay=0))
    print(f"\ntoo long: {dict(long)}; too short: {dict(brief)}")
    assert long["delay"] >= DRAWS - 1
    assert brief["delay"] >= DRAWS - 3


def closed_loop(rng, gain, n=3000):
    """A first-order plant whose input follows its output, with noise that the loop feeds back."""
    y, u, v = np.zeros(n), np.zeros(n), lfilter([1.0], [1.0, -0.7], 0.3 * rng.standard_normal(n))
    r = rng.standard_normal(n)
    for t in range(1, n):
        y[t] = 0.8 * (y[t - 1] - v[t - 1]) + 0.4 * u[t - 1] + v[t]
        u[t] = r[t] - gain * y[t]
    return uq.Record(u, y, 100.0)


def test_feedback_is_named_and_its_absence_is_not(rng):
    def told(gain):
        record = closed_loop(rng, gain)
        result = BJ(order=1).identify(record)
        return any(x.about == "feedback" for x in uq.validate.advise(record, result.model, result.covariance))

    closed, opened = (sum(told(gain) for _ in range(DRAWS)) for gain in (0.6, 0.0))
    print(f"\nfeedback named in {closed} of {DRAWS} closed loops and {opened} of {DRAWS} open ones")
    assert closed >= DRAWS - 1
    assert opened <= 1


def silence(rng, draws):
    count = Counter()
    for name in ("suite_rate", "easy"):
        count += heard(rng, as_it_is, BJ(order=5), draws, name)
    quiet = count["nothing"] / (2 * draws)
    print(f"\n{2 * draws} good records: nothing said of {quiet:.1%}; heard {dict(count)}")
    return quiet


@pytest.mark.slow
def test_good_records_hear_nothing(rng):
    assert silence(rng, 15) >= 0.8


@pytest.mark.slow
def test_two_hundred_good_records_hear_nothing(rng):
    assert silence(rng, 100) >= 0.93


def test_declared_limits_are_not_asked_for_again(rng):
    u, y = rng.standard_normal((1, 2000)), np.clip(rng.standard_normal((1, 2000)), -1.0, 1.0)
    known = uq.Record(u, y, 100.0, sensors=[uq.Channel("gauge", "V", -1.0, 1.0)])
    told, asked = (uq.validate.advise(record)[0].sentence for record in (known, uq.Record(u, y, 100.0)))
    assert "declare" in asked
    assert "declare" not in told
    assert "'output-error'" in told
