"""There and back through the packages beside this one: numbers to 1e-12, names, units and, where they fit, limits."""

import numpy as np
import pytest

import ultraquiet as uq

CLOSE = 1e-12
F_HZ = np.array([0.3, 1.0, 7.7])
SHAPES = [(1, 1), (4, 3), (3, 5)]


def wires(count, role, limits=True):
    units = ("N", "m/s", "", "µm")
    ends = [(-2.5, 3.5) if limits and k % 2 else (-np.inf, np.inf) for k in range(count)]
    return [uq.Channel(f"{role} {k}.{k} ü", units[k % 4], *ends[k]) for k in range(count)]


def system(seed, ny, nu, rate_hz=1234.5, scale=1.0, limits=True):
    rng = np.random.default_rng(seed)
    A = 0.3 * rng.standard_normal((4, 4))
    B, C, D = rng.standard_normal((4, nu)), scale * rng.standard_normal((ny, 4)), scale * rng.standard_normal((ny, nu))
    return uq.StateSpace(A, B, C, D, rate_hz, wires(nu, "drive", limits), wires(ny, "sense", limits))


def same_system(one, other):
    for key in "ABCD":
        a, b = getattr(one, key), getattr(other, key)
        assert a.shape == b.shape
        assert np.abs(a - b).max(initial=0.0) <= CLOSE * np.abs(a).max(initial=0.0)
    assert other.rate_hz == one.rate_hz
    assert (other.actuators, other.sensors) == (one.actuators, one.sensors)


@pytest.mark.parametrize(("ny", "nu"), SHAPES)
@pytest.mark.parametrize("rate_hz", [1234.5, 3500.0, None])
@pytest.mark.parametrize("scale", [1.0, 1e9, 1e-9])
def test_systems(ny, nu, rate_hz, scale, first_seed):
    bare, G = system(first_seed, ny, nu, rate_hz, scale, limits=False), system(first_seed, ny, nu, rate_hz, scale)
    same_system(bare, uq.StateSpace.from_control(bare.to_control()))
    same_system(G, uq.StateSpace.from_scipy(G.to_scipy()))
    same_system(G, uq.StateSpace.from_pandas(G.to_pandas()))
    same_system(G, uq.StateSpace.from_xarray(G.to_xarray()))


@pytest.mark.parametrize(("ny", "nu"), SHAPES)
@pytest.mark.parametrize("quality", [False, True])
def test_responses(ny, nu, quality, first_seed):
    rng = np.random.default_rng(first_seed)
    shape = (ny, nu, F_HZ.size)
    values = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    known = (rng.uniform(size=shape), rng.uniform(size=shape)) if quality else (None, None)
    ends = wires(nu, "drive"), wires(ny, "sense")
    G = uq.FrequencyResponse(F_HZ, values, known[0], "H1", *ends, variance=known[1])
    for back in (
        uq.FrequencyResponse.from_pandas(G.to_pandas()),
        uq.FrequencyResponse.from_xarray(G.to_xarray()),
    ):
        assert np.array_equal(back.values, G.values)
        assert np.array_equal(back.f_hz, G.f_hz)
        assert (back.actuators, back.sensors, back.estimator) == (G.actuators, G.sensors, G.estimator)
        for one, other in ((G.coherence, back.coherence), (G.variance, back.variance)):
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)
    through = uq.FrequencyResponse.from_control(G.to_control())
    assert np.abs(through.values - G.values).max() <= CLOSE * np.abs(G.values).max()
    assert np.abs(through.f_hz / G.f_hz - 1).max() <= CLOSE
    for one, other in zip((*G.actuators, *G.sensors), (*through.actuators, *through.sensors), strict=True):
        assert (one.name, one.unit) == (other.name, other.unit)


@pytest.mark.parametrize(("ny", "nu"), SHAPES)
def test_records(ny, nu, first_seed):
    rng = np.random.default_rng(first_seed)
    sides = rng.standard_normal((nu, 50)), 1e-9 * rng.standard_normal((ny, 50))
    record = uq.Record(*sides, 1234.5, wires(nu, "drive"), wires(ny, "sense"))
    for back in (uq.Record.from_pandas(record.to_pandas()), uq.Record.from_xarray(record.to_xarray())):
        assert back.hash == record.hash
        assert (back.actuators, back.sensors) == (record.actuators, record.sensors)
    forgetful = record.to_pandas()
    forgetful.attrs.clear()
    assert uq.Record.from_pandas(forgetful).rate_hz == pytest.approx(1234.5, rel=CLOSE)


def test_tables_of_other_people():
    import pandas as pd

    table = pd.DataFrame({"t": [0.0, 0.1, 0.2], "force": [1.0, 0.0, 0.0], "speed": [0.0, 0.5, 0.2]}).set_index("t")
    record = uq.Record.from_pandas(table, inputs="force", outputs=["speed"])
    assert record.rate_hz == 10.0
    assert record.sensors[0] == uq.Channel("speed", "")
    with pytest.raises(uq.errors.InputError, match="no column 'sped'; there are force, speed"):
        uq.Record.from_pandas(table, inputs="force", outputs="sped")
    with pytest.raises(uq.errors.InputError, match="say which columns"):
        uq.Record.from_pandas(table)
    with pytest.raises(uq.errors.InputError, match="even clock"):
        uq.Record.from_pandas(table.reset_index(drop=True), inputs="force", outputs="speed")


def test_systems_of_other_people():
    import control
    from scipy import signal

    lag = control.tf([1.0], [1.0, 2.0])
    assert uq.StateSpace.from_control(lag).actuators[0].name == "input 1"
    named = control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1, inputs=["force"], outputs=["speed [m/s]"])
    back = uq.StateSpace.from_control(named)
    assert back.actuators[0] == uq.Channel("force", "")
    assert back.sensors[0] == uq.Channel("speed", "m/s")
    filtered = uq.StateSpace.from_scipy(signal.dlti([1.0], [1.0, -0.5], dt=0.001), ["force"], ["speed"])
    assert (filtered.rate_hz, filtered.sensors[0].name) == (1000.0, "speed")
    for make, form in ((uq.StateSpace.from_scipy, signal.dlti([1.0], [1.0, -0.5])),):
        with pytest.raises(uq.errors.InputError, match="give it a dt"):
            make(form)


def test_channels_of_one_name_stay_apart_in_control():
    twice = uq.StateSpace([[0.5]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]], 10.0, ["push", "push"], ["speed"])
    assert [c.name for c in uq.StateSpace.from_control(twice.to_control()).actuators] == ["push", "push"]


def test_a_transfer_function_without_states_is_refused_at_every_door():
    import control
    from scipy import signal

    improper = control.tf([1, 0, 0], [1, 1])
    several = control.tf([[[1], [2]], [[1], [1]]], [[[1, 1], [1, 2]], [[1, 3], [1, 4]]])
    with pytest.raises(uq.errors.InputError, match="no state-space form"):
        uq.StateSpace.from_scipy(signal.TransferFunction([1, 0, 0], [1, 1]))
    for given in (improper, several):
        if given is several and control.exception.slycot_check():
            continue
        for door in (uq.StateSpace.from_control, uq.analyse.hinf_norm, uq.design.MixedSensitivity().design):
            with pytest.raises(uq.errors.InputError, match="no state-space form"):
                door(given)
