"""A tone that drives a sensor to the ends of its range: the figures say that it was cut off."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel, StateSpace

LAW = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[-0.5, 0.0]], 1000.0)


@pytest.mark.parametrize(("amplitude", "cut"), [(1.0, ()), (4.0, ("gap",))])
def test_sensors_at_the_ends_of_their_range_are_named(amplitude, cut):
    gap, far = Channel("gap", "µm", -3.0, 3.0), Channel("far", "µm", -100.0, 100.0)
    bench = Wrapped(
        lambda u, d: np.clip([u[0] + d[0]] * 2, [-3, -100], [3, 100]), lambda: None, 1000.0, ["coil"], [gap, far]
    )
    found = uq.simulate.attenuation(bench, LAW, (20.0,), amplitude, 0.5)
    print(found.cut, found.open_v)
    assert found.cut == (cut,)
