"""Dead and saturated channels are named; live ones are not, in any unit, quantised or not."""

import numpy as np
import pytest
from scipy.stats import binom

from ultraquiet._base.errors import InputError
from ultraquiet.identify import OutputError, channel_health
from ultraquiet.identify.health.answers import answers
from ultraquiet.signals import Chirp, Multisine, Prbs
from ultraquiet.values import Channel, Record, StateSpace, StatusWord

RATE_HZ = 2000.0


def plant(rng, ny, nu):
    """Lightly damped modes of every sensor and actuator."""
    modes = 4
    f, damping = rng.uniform(0.02, 0.3, modes), 0.99
    blocks = [damping * np.array([[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]]) for w in np.pi * f]
    A = np.zeros((2 * modes, 2 * modes))
    for k, block in enumerate(blocks):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
    return StateSpace(
        A, rng.standard_normal((2 * modes, nu)), rng.standard_normal((ny, 2 * modes)), np.zeros((ny, nu)), RATE_HZ
    )


def readings(rng, u, ny, noise=0.1):
    y = plant(rng, ny, len(u)).simulate(u)
    y /= y.std(axis=1, keepdims=True)
    return y + noise * rng.standard_normal(y.shape)


def quantised(y, bits, span=4.0):
    if bits is None:
        return y
    step = 2 * span / 2**bits
    return np.clip(np.round(y / step) * step, -span, span)


def record(u, y, unit=1.0, limit=np.inf):
    u_wires = [Channel(f"force {k + 1}", "N") for k in range(len(u))]
    y_wires = [Channel(f"acc {k + 1}", "m/s^2", -limit * unit, limit * unit) for k in range(len(y))]
    return Record(u / unit, y * unit, RATE_HZ, u_wires, y_wires)


def excitations(rng, n):
    yield "noise", rng.standard_normal((2, n))
    yield "one by one", np.stack([rng.standard_normal(n), np.zeros(n)])
    yield "prbs", np.stack([Prbs(stop_hz=400).generate(n, RATE_HZ, seed) for seed in (1, 2)])
    yield "chirp", np.stack([Chirp(5, 500).generate(n, RATE_HZ), np.zeros(n)])
    yield "multisine", np.stack([Multisine(5, 500, 1024).generate(n, RATE_HZ, seed) for seed in (1, 2)])


@pytest.mark.draws(false_alarm=1e-3)  # five excitations of 60 dead sensors; binomial at three levels
def test_a_sensor_that_hears_nothing_passes_for_a_live_one_as_often_as_stated(rng):
    n, ny = 4096, 60
    for name, u in excitations(rng, n):
        noise = rng.standard_normal((ny, n))
        noise[::2] = np.cumsum(noise[::2], axis=1) * 0.01 + noise[::2]  # half of them drift
        p, each = answers(Record(u, noise, RATE_HZ))
        for level in (0.2, 0.05, 1e-3):
            found = int(np.count_nonzero(p < level))
            most = int(binom.ppf(1 - 5e-5, ny, level))
            print(f"{name}: {found} of {ny} dead sensors with p < {level:g}, at most {most}")
            assert found <= most
        assert np.all(each[:, np.ptp(u, axis=1) == 0] == 1.0)


LOUD = pytest.param(1.0, marks=pytest.mark.draws(false_alarm=2e-2))  # 3 of 301 draws had a sensor that was blamed


@pytest.mark.parametrize("bits", [None, 16, 10, 8])
@pytest.mark.parametrize("noise", [0.0, 0.1, LOUD])
def test_live_channels_are_not_blamed(bits, noise, rng):
    """Twenty sensors under five excitations: no alarm, and hardly one where noise is as large as the signal."""
    for name, u in excitations(rng, 4096):
        y = quantised(readings(rng, u, 20, noise), bits, span=10.0 * (1 + noise))
        health = channel_health([record(u, y)])
        driven = np.ptp(u, axis=1) > 0
        said = [s for s in health.sensor_statuses if not s.ok]
        said += [s for s, drive in zip(health.actuator_statuses, driven, strict=True) if drive and not s.ok]
        assert not said, (name, [str(s) for s in said])


# 3 of 18 draws had one sensor, its noise about as large as its signal, that passed for one that hears nothing.
@pytest.mark.slow
@pytest.mark.draws(false_alarm=0.2)
def test_live_channels_are_not_blamed_at_length(rng):
    """False alarms among 10 000 live sensors, quantised and noisy at random: none."""
    alarms, count = [], 0
    for _ in range(100):
        for _, u in excitations(rng, int(rng.integers(2048, 16384))):
            noise, bits = 10 ** rng.uniform(-3, 0), int(rng.integers(8, 17))
            y = quantised(readings(rng, u, 20, noise), bits, 10.0 * (1 + noise))
            alarms += [str(s) for s in channel_health([record(u, y)]).sensor_statuses if not s.ok]
            count += 20
    print(f"{len(alarms)} false alarms among {count} live sensors", *alarms[:5], sep="\n")
    assert not alarms


def mains(n):
    return np.sin(2 * np.pi * 50.0 / RATE_HZ * np.arange(n))


FAULTS = {
    "constant": lambda y, rng: np.full_like(y, 0.3),
    "stuck half-way": lambda y, rng: np.where(np.arange(y.size) < y.size // 2, y, y[y.size // 2]),
    "stuck for a while": lambda y, rng: np.where(np.abs(np.arange(y.size) - y.size // 3) > 500, y, 0.7),
    "unplugged": lambda y, rng: 0.01 * rng.standard_normal(y.size),
    "unplugged, quantised": lambda y, rng: 0.001 * np.round(rng.standard_normal(y.size)),
    "toggling": lambda y, rng: 0.01 * (rng.standard_normal(y.size) > 0),
    "mains alone": lambda y, rng: mains(y.size) + 0.01 * rng.standard_normal(y.size),
}


@pytest.mark.draws(false_alarm=1e-3)  # the level at which a channel answers: 7 of 9000 dead ones with noise did
@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("shape", [(1, 1), (4, 3), (3, 5)], ids=str)
def test_a_dead_sensor_is_named_alone(shape, fault, unit, rng):
    ny, nu = shape
    u = rng.standard_normal((nu, 8192))
    y = readings(rng, u, ny)
    bad = ny - 1
    y[bad] = FAULTS[fault](y[bad], rng)
    health = channel_health([record(u, y, unit)])
    sensors, actuators = health.named(StatusWord.DEAD)
    assert sensors == (f"acc {ny}",)
    if ny > 1:
        assert actuators == ()
    sentence = health.sensor_statuses[bad].sentence
    print(sentence)
    assert f"'acc {ny}' is dead" in sentence
    assert "leave it out" in sentence


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
def test_a_dead_actuator_is_named_alone(unit, rng):
    u = rng.standard_normal((3, 8192))
    live = u.copy()
    live[1] = 0.0
    health = channel_health([record(u, readings(rng, live, 4), unit)])
    assert health.named(StatusWord.DEAD) == ((), ("force 2",))
    assert "no sensor answers to it" in health.actuator_statuses[1].sentence


def through_three_modes(rng):
    """Five actuators that follow from three commands, three sensors of which the second is dead."""
    u = rng.standard_normal((5, 3)) @ rng.standard_normal((3, 8192))
    y = readings(rng, u, 3)
    y[1] = rng.standard_normal(8192)
    return u, y


@pytest.mark.draws(false_alarm=2.5e-3)  # a test at the level of a thousandth; 5 of 5031 draws
@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
def test_actuators_that_are_driven_together_are_not_blamed_for_it(unit, rng):
    """None of the actuators can be told from the others, all are heard; a dead sensor is named."""
    u, y = through_three_modes(rng)
    assert channel_health([record(u, y, unit)]).named(StatusWord.DEAD) == (("acc 2",), ())


def test_rounding_of_actuators_that_are_driven_together_explains_nothing(rng):
    """Five inputs of three directions: what rounding made of the other two hung on the unit, and p-values on them."""
    u, y = through_three_modes(rng)
    (first, each), *others = (answers(record(u, y, unit)) for unit in (1.0, 1e9, 1e-9))
    for any_p, each_p in others:
        assert np.allclose(any_p, first, rtol=1e-6, atol=0.0)
        assert np.allclose(each_p, each, rtol=1e-6, atol=0.0)


@pytest.mark.draws(false_alarm=4.5e-3)  # a test at the level of a thousandth; 2 of 1733 draws
def test_an_actuator_beside_others_that_follow_from_each_other_is_judged_alone(rng):
    """A dead actuator is told from two that are driven alike."""
    u = rng.standard_normal((3, 8192))
    u[1] = -2.0 * u[0]
    live = u.copy()
    live[2] = 0.0
    assert channel_health([record(u, readings(rng, live, 3))]).named(StatusWord.DEAD) == ((), ("force 3",))


def test_records_of_one_actuator_each_are_judged_together(rng):
    """A sensor may hear one actuator alone; an actuator that no record drives is said."""
    n, system = 4096, plant(rng, 3, 3)
    system = StateSpace(system.A, system.B, system.C * [[1.0], [1.0], [0.0]], system.D, RATE_HZ)
    records = []
    for k in range(2):
        u = np.zeros((3, n))
        u[k] = rng.standard_normal(n)
        y = system.simulate(u)
        y[1] *= k == 1
        records.append(record(u, y + 0.1 * rng.standard_normal(y.shape)))
    health = channel_health(records)
    assert health.named(StatusWord.DEAD) == (("acc 3",), ("force 3",))
    assert "driven in no record" in health.actuator_statuses[2].sentence


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
@pytest.mark.parametrize("bits", [None, 16, 10])
@pytest.mark.parametrize("declared", [True, False])
def test_a_saturated_sensor_is_named_alone(declared, bits, unit, rng):
    u = rng.standard_normal((3, 8192))
    y = quantised(readings(rng, u, 4), bits, 10.0)
    y[2] = quantised(np.clip(y[2], -1.5, 1.5), bits, 10.0)
    limit = float(np.abs(y[2]).max()) if declared else np.inf
    whole = record(u, y, unit)
    wires = [*whole.sensors[:2], Channel("acc 3", "m/s^2", -limit * unit, limit * unit), whole.sensors[3]]
    health = channel_health([Record(whole.inputs, whole.outputs, RATE_HZ, whole.actuators, wires)])
    assert health.named(StatusWord.SATURATED) == (("acc 3",), ())
    assert health.named(StatusWord.DEAD) == ((), ())
    assert "lower the excitation" in health.sensor_statuses[2].sentence


def test_a_saturated_command_is_named_and_a_two_valued_one_is_not(rng):
    u = np.stack([np.clip(rng.standard_normal(8192), -1, 1), np.sign(rng.standard_normal(8192))])
    made = record(u, readings(rng, u, 2))
    wires = [Channel("a", "V", -1, 1), Channel("b", "V", -1, 1)]
    health = channel_health([Record(made.inputs, made.outputs, RATE_HZ, wires, made.sensors)])
    assert health.named(StatusWord.SATURATED) == ((), ("a",))


@pytest.mark.parametrize("per_period", [4, 8, 32, 100])
def test_a_tone_in_step_with_its_sampling_is_no_pile(per_period):
    t = (np.arange(8192) + 0.5) / per_period
    for bits in (None, 12):
        y = quantised(np.sin(2 * np.pi * t)[None], bits, 10.0)
        assert channel_health([record(np.cos(2 * np.pi * t)[None], y)]).named(StatusWord.SATURATED) == ((), ())


@pytest.mark.parametrize("periods", [20, 200])
def test_the_peak_of_a_period_is_no_pile_whatever_noise_makes_of_the_readings_beside_it(periods, rng):
    period, peak = quantised(rng.standard_normal((1, 1024)), 10, 6.0), slice(500, 503)
    step = 12.0 / 2**10
    period[0, peak] = period.max() + 10 * step
    u, y = np.tile(rng.standard_normal((1, 1024)), periods), np.tile(period, periods)
    beside = np.tile([peak.start - 1, peak.stop], periods) + np.repeat(1024 * np.arange(periods), 2)
    y[0, beside] += step * rng.integers(0, 3, beside.size)
    assert channel_health([record(u, y)]).named(StatusWord.SATURATED) == ((), ())


def test_a_pause_and_a_decay_are_no_standstill(rng):
    """Quantised readings rest while nothing is driven, and ring down into their last level."""
    n = 8192
    u = np.where(np.arange(n) < n // 2, rng.standard_normal(n), 0.0)[None]
    y = np.round(readings(rng, u, 3, noise=0.0) * 100) / 100
    assert channel_health([record(u, y)]).ok


def test_a_step_response_that_settled_is_no_pile():
    u = np.where(np.arange(4096) < 100, 0.0, 1.0)[None]
    system = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ)
    assert channel_health([record(u, system.simulate(u))]).named(StatusWord.SATURATED) == ((), ())


def test_short_records_blame_nobody(rng):
    assert channel_health([Record(rng.standard_normal((1, 60)), rng.standard_normal((1, 60)), RATE_HZ)]).ok


def test_what_cannot_be_judged_is_refused(rng):
    one = record(rng.standard_normal((1, 500)), rng.standard_normal((1, 500)))
    other = record(rng.standard_normal((1, 500)), rng.standard_normal((2, 500)))
    with pytest.raises(InputError, match="at least one"):
        channel_health([])
    with pytest.raises(InputError, match="record 2 has other channels"):
        channel_health([one, other])


def test_identification_refuses_a_sensor_that_stuck(rng):
    u = rng.standard_normal((1, 4096))
    y = readings(rng, u, 1)
    y[0, 3000:] = y[0, 3000]
    with pytest.raises(InputError, match=r"'acc 1' is dead in part: it stands still .* from sample 3000"):
        OutputError(order=2).identify(record(u, y))
