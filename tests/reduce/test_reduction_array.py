"""A small identified array from records to a reduced law; the 36-channel one is the benchmark `array_design`."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.analyse import h2_norm, hinf_norm
from ultraquiet.values.interconnect import feedback, lft


@pytest.fixture(scope="module")
def array(first_seed):
    """Two struts of the bench, four fifth-order Box-Jenkins models, 20 states."""
    bench = uq.bench.Hexapod(unit="ground", seed=first_seed)
    records = []
    for k in range(2):
        u = np.zeros((6, 8192))
        u[k] = uq.signals.BandLimitedNoise(stop_hz=1500, peak_v=10).generate(
            samples=8192, rate_hz=bench.rate_hz, seed=k
        )
        records.append(bench.run(u).pick([k], [0, 1]))
    return uq.identify.identify_matrix(uq.identify.BoxJenkins(order=5), records).state_space()


@pytest.mark.parametrize(
    ("method", "norm", "states", "allowed"),
    [
        (uq.design.MixedSensitivity(band_hz=(9.0, 108.0), height=12.0, disk_margin=0.0), "peak", 16, 0.05),
        (uq.design.Lqg(control_weight=1e-8, disturbance_at="input", disk_margin=0.0), "mean-square", 8, 0.01),
    ],
    ids=["hinf", "lqg"],
)
def test_small_array_is_designed_and_reduced_without_help(array, method, norm, states, allowed):
    result = method.design(array)
    assert result.status.ok
    if norm == "mean-square":
        P, size = method.generalised(array), h2_norm
    else:
        P, size = method.generalised(array, method.weights(array)), lambda loop: hinf_norm(loop)[0]
    small = uq.reduce.ClosedLoopWeighted(states=states, loss=allowed, norm=norm).reduce(result.controller, array, P)
    loss = size(lft(P, small.controller)) / size(lft(P, result.controller)) - 1
    print(f"{result.controller.states} -> {states} states, {norm} norm: {100 * loss:+.2f} %; {small.details['way']}")
    assert small.status.ok
    assert feedback(array, small.controller).is_stable()
    assert loss <= allowed
    assert abs(loss - small.loss) < 1e-4
