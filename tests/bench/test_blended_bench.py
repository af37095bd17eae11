"""Benches seen through blending matrices and at a control rate: the same numbers whichever way round."""

import copy
import pickle

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import content_hash
from ultraquiet.bench import Bench, Blended, Decimated, Hexapod, Streaming, Wrapped
from ultraquiet.testing.conformance import _bench
from ultraquiet.values import Blending, Channel, Decimation, StateSpace, SteppedController
from ultraquiet.values.interconnect import feedback

SHAPES = [(1, 1, 1, 1), (4, 3, 2, 3), (3, 5, 3, 2)]


class Linear:
    """A linear plant as an outsider would code it; the command acts one sample late, as the loop of a bench has it."""

    def __init__(self, system):
        self.system = system

    def reset(self):
        self.x = np.zeros(self.system.states)

    def step(self, u, d):
        y = self.system.C @ self.x + self.system.D @ (u + d)
        self.x = self.system.A @ self.x + self.system.B @ (u + d)
        return y


class Plain:
    """A bench with the four members of the protocol and no more."""

    def __init__(self, bench):
        self.rate_hz, self.actuators, self.sensors = bench.rate_hz, bench.actuators, bench.sensors
        self.run = lambda u, disturbance=None, controller=None: bench.run(u, disturbance, controller)


def drawn(rng, shape, limit=np.inf, unit=1.0):
    ny, nu, my, mu = shape
    A = rng.standard_normal((5, 5))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((5, nu)), unit * rng.standard_normal((ny, 5))
    plant = StateSpace(A, B, C, np.zeros((ny, nu)), 8000.0)
    wires = (
        [Channel(f"force {k}", "N", -limit, limit) for k in range(nu)],
        [Channel(f"a {k}", "m/s^2") for k in range(ny)],
    )
    made = Linear(plant)
    bench = Wrapped(made.step, made.reset, 8000.0, *wires)
    return (
        bench,
        plant,
        Blending(rng.standard_normal((my, ny)), rng.standard_normal((nu, mu)) / unit, wires[1], wires[0]),
    )


def late(plant):
    """The plant behind the bench's one sample of delay."""
    nu = plant.D.shape[1]
    A = np.block([[plant.A, plant.B], [np.zeros((nu, plant.states + nu))]])
    B = np.vstack([np.zeros_like(plant.B), np.eye(nu)])
    return StateSpace(A, B, np.hstack([plant.C, plant.D]), np.zeros_like(plant.D), plant.rate_hz)


def law_of(rng, blending, rate_hz):
    my, mu = len(blending.sensor_modes), len(blending.actuator_modes)
    C, D = 0.02 * rng.standard_normal((mu, 2)), 0.02 * rng.standard_normal((mu, my))
    return StateSpace(0.5 * np.eye(2), rng.standard_normal((2, my)), C, D, rate_hz)


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_bench_in_modes_is_the_plant_in_modes(shape, unit, rng):
    inner, plant, blending = drawn(rng, shape, unit=unit)
    bench = Blended(inner, blending)
    assert isinstance(bench, Bench)
    law, v = law_of(rng, blending, 8000.0), unit * rng.standard_normal((shape[3], 80))
    truth = blending.plant(late(plant))
    record = bench.run(v)
    size = np.abs(record.outputs).max()
    assert np.allclose(record.outputs, truth.simulate(v), rtol=0, atol=1e-10 * size)
    assert np.array_equal(record.inputs, v)  # a mode at rest is at rest, not at rounding
    closed = [bench.run(v, controller=k).outputs for k in (law, SteppedController(law))]
    mapped = inner.run(blending.actuator_matrix @ v, controller=blending.law(law)).outputs
    expected = feedback(truth, law).simulate(v)
    for one in (*closed, blending.sensor_matrix @ mapped):
        assert np.allclose(one, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("latency", [None, 1, 3])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_bench_at_the_control_rate_is_the_closed_form(shape, latency, rng):
    inner, plant, blending = drawn(rng, shape)
    decimation = Decimation(4, latency=latency)
    bench = Decimated(Blended(inner, blending), decimation)
    truth = decimation.plant(blending.plant(late(plant)))
    law, v = law_of(rng, blending, 2000.0), rng.standard_normal((shape[3], 60))
    record = bench.run(v)
    assert record.rate_hz == 2000.0
    assert np.allclose(record.outputs, truth.simulate(v), rtol=0, atol=1e-10 * np.abs(record.outputs).max())
    assert np.array_equal(record.inputs, v)
    expected = feedback(truth, law).simulate(v)
    seen = bench.run(v, controller=law)
    assert np.allclose(seen.outputs, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    # On the bench itself, at its own rate, with the law that filters, blends and holds by itself.
    held = bench.on_the_bench(law)
    outer = inner.run(blending.actuator_matrix @ decimation.held(v), controller=bench.bench.on_the_bench(held))
    assert np.allclose(
        decimation.record(inner.run(decimation.held(blending.actuator_matrix @ v))).outputs,
        Decimated(inner, decimation).run(blending.actuator_matrix @ v).outputs,
        rtol=0,
        atol=1e-12,
    )
    filtered = decimation.readings(blending.sensor_matrix @ outer.outputs)
    assert np.allclose(filtered, seen.outputs, rtol=0, atol=1e-9 * np.abs(expected).max())


def blended(bench, blending):
    return Blended(bench, blending)


def decimated(bench, blending):
    return Decimated(bench, Decimation(4))


def both(bench, blending):
    return Decimated(Blended(bench, blending), Decimation(3, latency=1))


@pytest.mark.parametrize("wrap", [blended, decimated, both])
@pytest.mark.parametrize("plain", [False, True])
def test_they_keep_what_benches_promise(wrap, plain, rng, seed):
    inner, _, blending = drawn(rng, (4, 3, 2, 3))
    bench = wrap(Plain(inner) if plain else inner, blending)
    assert isinstance(bench, Streaming)
    if not plain:
        _bench("wrapped twice", bench, seed)
    else:
        u = rng.standard_normal((3, 50))
        assert np.array_equal(bench.run(u).outputs, wrap(inner, blending).run(u).outputs)
        assert list(bench.stream(u, stop=lambda: True)) == []
    assert not hasattr(bench, "linear_model")
    assert not hasattr(bench, "side_by_side")


def test_limits_are_the_modes_and_are_counted(rng):
    inner, _, blending = drawn(rng, (4, 3, 2, 3), limit=2.0)
    bench = Decimated(Blended(inner, blending), Decimation(4))
    high = np.array([c.high for c in bench.actuators])
    record = bench.run(np.stack([3 * high, -3 * high, 0 * high], axis=1))
    assert np.array_equal(record.inputs, np.stack([high, -high, 0 * high], axis=1))
    assert record.provenance.settings["limited_commands"] == [2, 2, 2]
    assert record.provenance.settings["bench"] == "bench.blended"


def test_a_linear_model_is_offered_where_the_bench_has_one(rng):
    inner, plant, blending = drawn(rng, (4, 3, 2, 3))

    class Known(Plain):
        side_by_side = True

        def linear_model(self):
            return late(plant)

    bench = Decimated(Blended(Known(inner), blending), Decimation(4))
    assert bench.linear_model().rate_hz == 2000.0
    assert bench.linear_model().D.shape == (2, 3)
    assert bench.side_by_side


def test_the_hexapod_in_modes_is_its_own_linear_model(rng):
    """A bench with a model of its own and a fast way of its own to run linear laws."""
    inner = Hexapod(unit="flight", linear=True)
    blending = Blending(rng.standard_normal((3, 6)), rng.standard_normal((6, 3)), inner.sensors, inner.actuators)
    bench = Decimated(Blended(inner, blending), Decimation(2))
    v = 1e-3 * rng.standard_normal((3, 200))
    law = law_of(rng, blending, 1750.0)
    law = StateSpace(law.A, law.B, 0.01 * law.C, 0.01 * law.D, 1750.0)
    for truth, record in (
        (bench.linear_model(), bench.run(v)),
        (feedback(bench.linear_model(), law), bench.run(v, controller=law)),
    ):
        expected = truth.simulate(v)
        assert np.allclose(record.outputs, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    fast = Blended(inner, blending)
    law = StateSpace(law.A, law.B, law.C, law.D, 3500.0)
    stepped = fast.run(v, controller=SteppedController(law)).outputs
    assert np.allclose(fast.run(v, controller=law).outputs, stepped, rtol=0, atol=1e-9 * np.abs(stepped).max())


def test_copies_and_hashes_are_those_of_equal_benches():
    def made(gain):
        inner = Hexapod(unit="flight", linear=True)
        return Decimated(
            Blended(inner, Blending(gain * np.eye(6), np.eye(6), inner.sensors, inner.actuators)), Decimation(2)
        )

    bench = made(1.0)
    for other in (made(1.0), copy.deepcopy(bench), pickle.loads(pickle.dumps(bench))):
        assert content_hash(other) == content_hash(bench)
        assert np.array_equal(other.run(np.ones((6, 9))).outputs, bench.run(np.ones((6, 9))).outputs)
    assert content_hash(made(2.0)) != content_hash(bench)


def test_units_are_kept():
    wires = [Channel("geo", "V"), Channel("acc", "m/s^2"), Channel("vel", "m/s")]
    inner = Wrapped(lambda u, d: [1.0, 2.0, 3.0], lambda: None, 8000.0, [Channel("coil", "A")], wires)
    bench = Decimated(Blended(inner, Blending(np.eye(3), [[1.0]], wires, inner.actuators)), Decimation(4))
    record = bench.run([[0.0, 0.0]])
    assert [c.unit for c in record.sensors] == ["V", "m/s^2", "m/s"]
    assert record.actuators[0].unit == "A"


def test_a_blending_of_other_channels_is_refused(rng):
    inner, _, blending = drawn(rng, (4, 3, 2, 3))
    other, _, _ = drawn(rng, (3, 5, 2, 3))
    with pytest.raises(InputError, match="it blends 3 actuators, got 5"):
        Blended(other, blending)
    with pytest.raises(InputError, match="from 2 to 3 modes is needed"):
        Blended(inner, blending).run(
            np.zeros((3, 5)), controller=StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], 8000.0)
        )
