"""The hexapod in blocks: the same bits as in one run, and the soft stop."""

import numpy as np
import pytest

from ultraquiet import StateSpace
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Hexapod, Streaming, Tally
from ultraquiet.bench._abstract import fade
from ultraquiet.values import SteppedController

RATE = 3500.0


def some_law(rng, states=5):
    A = np.diag(rng.uniform(-0.9, 0.9, states))
    B, C = 1e-2 * rng.normal(size=(states, 6)), 1e-2 * rng.normal(size=(6, states))
    return StateSpace(A, B, C, 1e-3 * rng.normal(size=(6, 6)), rate_hz=RATE)


def joined(blocks):
    blocks = list(blocks)
    return np.hstack([b.command for b in blocks]), np.hstack([b.readings for b in blocks]), blocks


def kept(into, blocks):
    for block in blocks:
        into.append(block)


@pytest.mark.parametrize("block", [1, 97, 175, 10_000])
@pytest.mark.parametrize("kind", ["open", "linear", "stepped"])
def test_blocks_are_the_run_bit_for_bit(kind, block, rng, seed):
    law = some_law(rng)
    law = {"open": None, "linear": law, "stepped": SteppedController(law)}[kind]
    u, d = 20.0 * rng.normal(size=(6, 700)), 60.0 * rng.normal(size=(6, 700))
    bench = Hexapod(seed=seed, hysteresis=True)
    record = bench.run(u, d, law, run_index=4)
    command, readings, blocks = joined(bench.stream(u, d, law, run_index=4, block_samples=block))
    assert np.array_equal(command, record.inputs)
    assert np.array_equal(readings, record.outputs)
    settings = record.provenance.settings
    tally = Tally()
    for one in blocks:
        tally.take(one)
    print({name: count for name, count in tally.counts().items() if np.any(count)})
    assert tally.counts().items() <= settings.items()
    assert all(tally.counts()["limited_stacks"])
    assert set(settings) - set(bench.provenance.settings) - set(tally.counts()) == {"run_index", "temperature_c"}
    assert tally.told() == tally.counts()  # the name until 0.1
    assert max(b.command.shape[1] for b in blocks) == min(block, 700)
    assert bench.provenance.settings.items() <= settings.items()


def test_it_streams_and_numbers_its_runs():
    bench, quiet = Hexapod(), np.zeros((6, 50))
    assert isinstance(bench, Streaming)
    assert bench.provenance.seed == 0
    first, second = joined(bench.stream(quiet))[1], bench.run(quiet).outputs
    assert np.array_equal(first, Hexapod().run(quiet, run_index=0).outputs)
    assert np.array_equal(second, Hexapod().run(quiet, run_index=1).outputs)


@pytest.mark.parametrize("stepped", [False, True])
def test_a_stop_fades_command_law_and_disturbance(stepped, rng, seed):
    """The stopped run is the run of a plant whose every input was multiplied by the fade from there on."""
    law = some_law(rng)
    u, d = rng.normal(size=(6, 900)), rng.normal(size=(6, 900))
    bench = Hexapod(seed=seed, saturate=False)
    asked = []

    def stop():
        asked.append(1)
        return len(asked) > 3

    given = SteppedController(law) if stepped else law
    command, readings, blocks = joined(
        bench.stream(u, d, given, run_index=0, block_samples=100, stop=stop, ramp_samples=150)
    )
    whole = bench.run(u, d, law, run_index=0)
    assert command.shape == readings.shape == (6, 450)
    assert len(asked) == 4
    assert [b.command.shape[1] for b in blocks] == [100, 100, 100, 100, 50]
    assert command[:, :300] == pytest.approx(whole.inputs[:, :300], abs=1e-12)
    gain = np.r_[np.ones(300), fade(150, 150)]
    twin = SteppedController(law)
    formed = np.array([twin.step(y) for y in readings.T]).T
    assert command == pytest.approx(gain * (u[:, :450] + formed), abs=1e-9)
    assert not command[:, -1].any()
    replayed = bench.run(command, gain * d[:, :450], run_index=0)
    assert readings == pytest.approx(replayed.outputs, abs=1e-9)


def test_a_stop_near_the_end_does_not_lengthen_the_run():
    u = np.ones((6, 120))
    command, _, _ = joined(Hexapod().stream(u, block_samples=100, stop=lambda: True, ramp_samples=1000))
    assert command.shape == (6, 120)
    assert command[0] == pytest.approx(fade(120, 1000))


class Failing:
    def reset(self):
        self.k = 0

    def step(self, y):
        self.k += 1
        if self.k > 130:
            raise RuntimeError("boom")
        return np.zeros(6)


def test_what_was_measured_before_a_failure_is_handed_over():
    blocks, quiet = [], np.zeros((6, 300))
    with pytest.raises(RuntimeError, match="boom"):
        kept(blocks, Hexapod().stream(quiet, controller=Failing(), block_samples=100))
    assert [b.readings.shape[1] for b in blocks] == [100, 30]


def test_a_law_that_runs_away_is_named_with_its_sample(rng):
    law = StateSpace(1e30 * np.eye(6), np.eye(6), np.eye(6), np.eye(6), rate_hz=RATE)
    blocks = []
    with pytest.raises(InputError, match=r"at sample [0-9]+ the controller's command was no longer a finite number"):
        kept(blocks, Hexapod().stream(np.zeros((6, 300)), controller=law))
    assert blocks
    assert np.isfinite(blocks[-1].command).all()


@pytest.mark.parametrize("bad", [{"block_samples": 0}, {"ramp_samples": 0}, {"run_index": -1}])
def test_bad_settings_are_refused_before_the_first_block(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        Hexapod().stream(np.zeros((6, 10)), **bad)
