"""Levels that a list leaves open follow the limits of its actuators, and are said; a disk keeps the names it knows."""

import pytest

from ultraquiet import experiments
from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel

EXCITE = '[[commands]]\ndo = "excite"\nname = "{name}"\nactuator = {actuator}\nsamples = 300\nsignal = {{ {signal} }}\n'
NOISE = EXCITE.format(name="rough", actuator='"each"', signal='method = "noise"')
DISTURB = '[[commands]]\ndo = "disturbance-on"\nactuator = 1\nsignal = { method = "tone", frequency_hz = 40.0 }\n'


def bench(*actuators):
    return Wrapped(lambda u, d: u[:1], lambda: None, 1000.0, actuators, ["speed"])


PUSH, PULL, FREE = Channel("push", "um", -40.0, 25.0), Channel("pull", "N", -2.0, 8.0), Channel("free", "N")


def test_a_level_is_a_tenth_of_what_each_actuator_may_swing():
    listed = experiments.parse(NOISE, bench(PUSH, PULL, FREE))
    peaks = [m.drives[0].signal.peak for m in listed.measurements]
    assert peaks == pytest.approx([2.5, 0.2, 1.0])
    (said,) = listed.said
    assert said == (
        "'rough' names no level: 2.5 um (a tenth of the swing) on push; 0.2 N (a tenth of the swing) on pull; 1 N "
        "(without limits) on free."
    )


@pytest.mark.parametrize("key", ["limit", "limit_v"])
def test_a_limit_of_the_list_narrows_the_swing(key):
    configured = f'[[commands]]\ndo = "configure"\n{key} = 5.0\n'
    listed = experiments.parse(configured + NOISE, bench(PUSH, FREE))
    assert [m.drives[0].signal.peak for m in listed.measurements] == [0.5, 0.5]


def test_a_disturbance_has_its_level_likewise():
    listed = experiments.parse(DISTURB + NOISE, bench(PULL))
    assert listed.measurements[0].disturbances[0].signal.amplitude == pytest.approx(0.2)
    assert [sentence.split(" names")[0] for sentence in listed.said] == ["the disturbance of line 1", "'rough'"]


def test_nothing_is_said_of_levels_that_are_named():
    named = EXCITE.format(name="loud", actuator=1, signal='method = "noise", peak = 7.0')
    listed = experiments.parse(named, bench(PUSH))
    assert (listed.said, listed.measurements[0].drives[0].signal.peak) == ((), 7.0)


@pytest.mark.parametrize("key", ["peak", "peak_v"])
def test_a_measurement_is_the_same_under_both_names_and_written_down_as_before(key):
    named = EXCITE.format(name="loud", actuator=1, signal=f'method = "noise", {key} = 7.0')
    (measured,) = experiments.parse(named, bench(PUSH)).measurements
    (drive,) = measured.describe()["excitation"]
    assert (drive["peak_v"], "peak" in drive) == (7.0, False)
