"""Plants from outside and recordings."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.bench import Bench, Hexapod, Replay, Streaming, Wrapped
from ultraquiet.values import Channel, Record, StateSpace


class Plant:
    """The hexapod's linear truth without its computing delay, as an outsider would code it."""

    def __init__(self, unit):
        model = Hexapod(unit=unit, linear=True).linear_model()
        n = model.states - 6  # the last six states hold the commands for a sample
        self.A, self.B, self.C = model.A[:n, :n], model.A[:n, n:], model.C[:, :n]
        self.resets = 0

    def reset(self):
        self.resets += 1
        self.x = np.zeros(len(self.A))

    def step(self, u, d):
        y = self.C @ self.x
        self.x = self.A @ self.x + self.B @ (u + d)
        return y


def test_a_wrapped_plant_runs_like_the_bench_it_copies(rng):
    plant, bench = Plant("flight"), Hexapod(unit="flight", linear=True)
    wrapped = Wrapped(
        plant.step, plant.reset, 3500.0, [f"strut {i}" for i in range(6)], [f"strut {i}" for i in range(6)]
    )
    law = StateSpace(0.5 * np.eye(6), 0.01 * np.eye(6), np.eye(6), 0.002 * rng.normal(size=(6, 6)), rate_hz=3500.0)
    u, d = rng.normal(size=(2, 6, 200))
    assert isinstance(wrapped, Bench)
    for controller in (None, law):
        theirs, ours = wrapped.run(u, d, controller), bench.run(u, d, controller)
        assert np.allclose(theirs.outputs, ours.outputs, atol=1e-9)
        assert np.allclose(theirs.inputs, ours.inputs, atol=1e-9)
    assert plant.resets == 2


def test_a_wrapped_plant_is_limited_by_its_actuators():
    bench = Wrapped(lambda u, d: u, lambda: None, 10.0, [Channel("force", "N", -1.0, 2.0)], ["position"])
    record = bench.run([[5.0, -5.0, 0.0]])
    assert record.inputs.tolist() == [[2.0, -1.0, 0.0]]
    assert record.outputs.tolist() == [[0.0, 2.0, -1.0]]


def test_a_plant_that_keeps_its_arguments_cannot_spoil_the_record():
    kept = []

    def step(u, d):
        kept.append(u)
        u += 100.0
        return [0.0]

    record = Wrapped(step, lambda: None, 10.0, ["a"], ["b"]).run([[1.0, 2.0, 3.0]])
    assert record.inputs.tolist() == [[1.0, 2.0, 3.0]]
    assert [float(u[0]) for u in kept] == [100.0, 101.0, 102.0]


def test_replay_returns_its_records():
    records = tuple(Record(np.full((2, 5), k), np.arange(5.0)[None] + k, 100.0) for k in (1.0, 2.0))
    bench = Replay(records)
    assert isinstance(bench, Bench)
    assert bench.run(np.full((2, 5), 2.0)) is records[1]
    assert bench.rate_hz == 100.0


def short(given):
    return Wrapped(lambda u, d: given, lambda: None, 10.0, ["a"], ["b", "c"])


TAPE = Replay((Record(np.ones((1, 3)), np.ones((1, 3)), 10.0),))
BAD = [
    (lambda: short([1.0]).run([[0.0]]), InputError, "at sample 0 the plant must return 2 finite readings"),
    (lambda: short([1.0, np.nan]).run([[0.0]]), InputError, "2 finite readings"),
    (lambda: short([1.0, 1.0]).run([[0.0], [0.0]]), InputError, r"shape \(1, samples\)"),
    (lambda: Wrapped(None, print, 1.0, ["a"], ["b"]), InputError, "'step' must be a function"),
    (lambda: Wrapped(print, print, -1.0, ["a"], ["b"]), InputError, "'rate_hz' must be above zero"),
    (
        lambda: short([1.0, 1.0]).run(
            [[0.0]],
            controller=StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.zeros((1, 2)), rate_hz=20.0),
        ),
        RateError,
        "20 Hz",
    ),
    (lambda: Replay(()), InputError, "at least one record"),
    (lambda: Replay("records.h5"), InputError, "must be a tuple of records, got 'r' as number 1"),
    (lambda: TAPE.run(np.zeros((1, 3))), InputError, "none of the 1 records"),
    (lambda: TAPE.run(np.ones((1, 3)), disturbance=np.ones((1, 3))), InputError, "cannot react"),
]


@pytest.mark.parametrize("case", BAD, ids=[c[2] for c in BAD])
def test_bad_input_is_refused(case):
    call, kind, words = case
    with pytest.raises(kind, match=words):
        call()


def mixed(rng):
    """A plant with a direct part and memory, and limits that random commands meet."""
    plant = Plant("flight")
    names = [f"strut {i}" for i in range(6)]
    actuators = [Channel(name, "V", -2.0, 2.0) for name in names]
    sensors = [Channel(name, "V", -0.01, 0.01) for name in names]
    bench = Wrapped(plant.step, plant.reset, 3500.0, actuators, sensors)
    law = StateSpace(0.5 * np.eye(6), 0.01 * np.eye(6), np.eye(6), 0.002 * rng.normal(size=(6, 6)), rate_hz=3500.0)
    return bench, law


def joined(blocks):
    blocks = list(blocks)
    return tuple(np.concatenate([getattr(b, name) for b in blocks], axis=1) for name in ("command", "readings"))


@pytest.mark.parametrize("closed", [False, True])
def test_a_stream_put_together_is_the_run_to_the_bit(rng, closed):
    bench, law = mixed(rng)
    law = law if closed else None
    u, d = 2.0 * rng.normal(size=(2, 6, 101))
    record = bench.run(u, d, law)
    assert isinstance(bench, Streaming)
    for size in (1, 7, 100, 101, 500):
        blocks = list(bench.stream(u, d, law, block_samples=size))
        assert [b.command.shape[1] for b in blocks[:-1]] == [size] * (len(blocks) - 1)
        command, readings = joined(blocks)
        assert np.array_equal(command, record.inputs)
        assert np.array_equal(readings, record.outputs)
        assert sum(b.limited_readings for b in blocks).tolist() == list(record.clipped())
        assert sum(b.limited_commands for b in blocks).tolist() == record.provenance.settings["limited_commands"]
    assert max(record.provenance.settings["limited_commands"]) > 0


def test_a_soft_stop_fades_commands_and_disturbance(rng):
    at_plant = []
    bench = Wrapped(lambda u, d: at_plant.append([*u, *d]) or [0.0], lambda: None, 10.0, ["a"], ["b"])
    pressed = iter([False, False, True])
    blocks = bench.stream(
        np.ones((1, 100)), np.full((1, 100), 2.0), block_samples=10, stop=lambda: next(pressed), ramp_samples=25
    )
    command, readings = joined(blocks)
    assert command.shape == readings.shape == (1, 45)
    assert np.allclose(command[0, 20:], 1 - np.arange(1, 26) / 25, atol=1e-15)
    assert command[0, -1] == 0.0
    assert np.allclose(np.array(at_plant)[20:, 1], 2 * (1 - np.arange(1, 26) / 25), atol=1e-15)


@pytest.mark.parametrize("rate_hz", [20.0, 500.0, 3500.0])
def test_a_stop_and_its_ramp_take_as_long_at_every_rate(rate_hz):
    """Nobody names samples: blocks of 50 ms, and a tenth of a second to zero."""
    bench = Wrapped(lambda u, d: [0.0], lambda: None, rate_hz, ["a"], ["b"])
    pressed = iter([False, True])
    blocks = list(bench.stream(np.ones((1, round(2 * rate_hz))), stop=lambda: next(pressed)))
    command = joined(blocks)[0][0]
    first = blocks[0].command.shape[1]
    print(f"{rate_hz:g} Hz: a block of {first}, then {command.size - first} samples to zero")
    assert first == 0.05 * rate_hz
    assert command.size - first == 0.1 * rate_hz
    assert np.array_equal(command[first:], 1 - np.arange(1, 0.1 * rate_hz + 1) / (0.1 * rate_hz))


def test_a_soft_stop_fades_a_controller_too(rng):
    bench = Wrapped(lambda u, d: [1.0], lambda: None, 10.0, ["a"], ["b"])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3.0]], rate_hz=10.0)
    pressed = iter([False, True])
    command, _ = joined(
        bench.stream(np.zeros((1, 30)), None, law, block_samples=5, stop=lambda: next(pressed), ramp_samples=4)
    )
    assert command[0].tolist() == [3.0] * 5 + [2.25, 1.5, 0.75, 0.0]


def test_what_was_measured_before_a_failure_is_handed_over(rng):
    fails_at = int(rng.integers(1, 400))
    count = iter(range(1000))

    def step(u, d):
        k = next(count)
        if k == fails_at:
            raise OSError("cable")
        return [float(k)]

    seen = []
    stream = Wrapped(step, lambda: None, 10.0, ["a"], ["b"]).stream(np.zeros((1, 1000)), block_samples=64)
    with pytest.raises(OSError, match="cable"):
        seen.extend(y for block in stream for y in block.readings[0].tolist())
    assert seen == list(range(fails_at))
    print(f"failure at sample {fails_at}: {len(seen)} samples handed over")


def test_bad_stream_settings_are_refused_before_anything_moves():
    resets = []
    bench = Wrapped(lambda u, d: [0.0], lambda: resets.append(1), 10.0, ["a"], ["b"])
    for bad in ({"block_samples": 0}, {"ramp_samples": 0}, {"run_index": -1}):
        with pytest.raises(InputError, match=next(iter(bad))):
            bench.stream(np.zeros((1, 5)), **bad)
    assert not resets


def tape(rng):
    actuators, sensors = [Channel("force", "N", -1.0, 1.0)], [Channel("speed", "V", -2.0, 2.0)]
    u = rng.uniform(-1, 1, (3, 1, 50))
    return tuple(Record(u[k], rng.normal(size=(1, 50)), 100.0, actuators, sensors) for k in (0, 1, 1, 2))


def test_a_replay_streams_what_it_runs(rng):
    records = tape(rng)
    bench = Replay(records)
    assert isinstance(bench, Streaming)
    for size in (1, 7, 50, 99):
        blocks = list(bench.stream(records[3].inputs, block_samples=size))
        command, readings = joined(blocks)
        assert np.array_equal(command, records[3].inputs)
        assert np.array_equal(readings, records[3].outputs)
        assert sum(b.limited_readings for b in blocks).tolist() == list(records[3].clipped())
    pressed = iter([False, False, True])
    command, _ = joined(bench.stream(records[0].inputs, block_samples=10, stop=lambda: next(pressed)))
    assert np.array_equal(command, records[0].inputs[:, :20])
    assert bench.provenance.parents == tuple(r.hash for r in records)


def test_repetitions_are_replayed_in_their_order(rng):
    records = tape(rng)
    again = [Replay(records).run(records[1].inputs, run_index=k) for k in range(3)]
    assert again[0] is again[2] is records[1]
    assert again[1] is records[2]


def test_what_is_asked_of_a_replay_is_limited_as_on_the_bench(rng):
    u = rng.uniform(-3, 3, (1, 40))
    bench = Wrapped(lambda u, d: u, lambda: None, 10.0, [Channel("force", "N", -1.0, 1.0)], ["position"])
    record = bench.run(u)
    assert Replay((record,)).run(u, disturbance=np.zeros((1, 40))) is record


def test_a_replay_says_where_the_nearest_record_differs(rng):
    records = tape(rng)
    asked = np.array(records[3].inputs)
    asked[0, 17] = 0.0
    with pytest.raises(InputError, match=r"record 4, differs first in 'force' at sample 17, .* and 0 is asked"):
        Replay(records).run(asked)
    with pytest.raises(InputError, match="they are 50 samples long"):
        Replay(records).run(asked[:, :10])
    with pytest.raises(InputError, match="record 2 has other channels"):
        Replay((records[0], Record([[1.0]], [[1.0]], 100.0)))
    with pytest.raises(RateError, match="record 2"):
        Replay((records[0], Record([[1.0]], [[1.0]], 50.0)))


@pytest.mark.parametrize("given", [None, "off", [[], [1.0]], np.nan, [1.0, 2.0]])
def test_a_function_that_returns_no_reading_is_named(given):
    bench = Wrapped(lambda u, d: given, lambda: None, 100.0, ["force"], ["speed"])
    with pytest.raises(InputError, match=r"Wrapped.run: at sample 0 the plant must return 1 finite reading, got"):
        bench.run([[1.0, 0.0]])
