"""How the simulated bench runs: timing, limits, noise, controllers, refusals and speed."""

import pickle
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from ultraquiet import StateSpace, signals
from ultraquiet._base.errors import InputError, RateError
from ultraquiet._base.registry import methods
from ultraquiet.bench import Bench, Hexapod
from ultraquiet.bench._abstract import fade
from ultraquiet.bench.hexapod.physics.drift import REFERENCE_C
from ultraquiet.values import SteppedController

sys.path.insert(0, str(Path(__file__).parent))
from plain_loop import plain_loop

UNITS = ("ground", "flight", "rigid")
RATE = 3500.0


def some_law(rng, states=7):
    """Return a random law so weak that the loop is stable by the small-gain theorem: |K| = 0.05, |G| < 16."""
    A = rng.normal(size=(states, states))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, D = rng.normal(size=(6, states)), rng.normal(size=(6, 6))
    law = StateSpace(A, rng.normal(size=(states, 6)), C, D, rate_hz=RATE)
    g = np.moveaxis(law.frequency_response(np.linspace(0.0, RATE / 2, 500)), -1, 0)
    weak = 0.05 / np.linalg.norm(g, 2, axis=(1, 2)).max()
    return StateSpace(law.A, law.B, weak * C, weak * D, rate_hz=RATE)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize(
    "options", [{}, {"adc_bits": 16}, {"quantise": False}, {"saturate": False}, {"hysteresis": True}, {"linear": True}]
)
def test_the_kernel_does_what_plain_numpy_does(unit, options, rng, seed):
    bench = Hexapod(unit=unit, seed=seed, **options)
    law = some_law(rng)
    u, d = 12.0 * rng.normal(size=(6, 400)), 30.0 * rng.normal(size=(6, 400))
    record = bench.run(u, d, law)
    plant = (*bench.model.sampled, *bench._matrices(REFERENCE_C)[3:])
    inside = law.A, law.B, law.C, law.D
    command, readings, counts = plain_loop(plant, inside, u.T, d.T, bench._noise(0)(400), bench._limits.arrays)
    off = np.abs(record.outputs - readings.T).max()
    print(f"{unit} {options}: readings differ by {off:.1e} V")
    # Rounding hides the differences of 1e-13 V, unless one straddles a threshold: about once in 1e7 tests.
    assert off < 1e-9
    assert np.abs(record.inputs - command.T).max() < 1e-9
    assert record.provenance.settings["limited_commands"] == counts[0].tolist()
    assert record.provenance.settings["limited_stacks"] == counts[1].tolist()


@pytest.mark.parametrize("unit", UNITS)
def test_the_kernel_does_what_plain_numpy_does_with_all_instruments_and_a_fade(unit, rng, seed):
    bench = Hexapod(unit=unit, seed=seed, instruments="all", hysteresis=True)
    A = np.diag(rng.uniform(-0.9, 0.9, 5))
    B, C = 1e-2 * rng.normal(size=(5, 12)), 1e-2 * rng.normal(size=(8, 5))
    law = StateSpace(A, B, C, 1e-3 * rng.normal(size=(8, 12)), rate_hz=RATE)
    u, d = 12.0 * rng.normal(size=(8, 300)), 30.0 * rng.normal(size=(8, 300))
    asked = iter([False, True])
    blocks = list(
        bench.stream(u, d, law, run_index=0, block_samples=100, stop=lambda: next(asked, True), ramp_samples=150)
    )
    gain = np.r_[np.ones(100), fade(150, 150)]
    plant = (*bench.model.sampled, *bench._matrices(REFERENCE_C)[3:])
    inside = law.A, law.B, law.C, law.D
    plain = plain_loop(plant, inside, u.T[:250], d.T[:250], bench._noise(0)(250), bench._limits.arrays, gain)
    off = np.abs(np.hstack([b.readings for b in blocks]) - plain[1].T).max()
    print(f"{unit}: readings differ by {off:.1e} V")
    assert off < 1e-9
    assert np.abs(np.hstack([b.command for b in blocks]) - plain[0].T).max() < 1e-9
    assert sum(b.limited_commands for b in blocks).tolist() == plain[2][0].tolist()


def test_a_stepped_controller_gives_the_record_of_the_compiled_one(rng, seed):
    law = some_law(rng)
    u = 15.0 * rng.normal(size=(6, 300))
    compiled = Hexapod(seed=seed).run(u, controller=law)
    stepped = Hexapod(seed=seed).run(u, controller=SteppedController(law))
    assert np.abs(compiled.outputs - stepped.outputs).max() < 1e-9
    assert np.abs(compiled.inputs - stepped.inputs).max() < 1e-9
    assert compiled.provenance.settings == stepped.provenance.settings


@pytest.mark.parametrize("unit", UNITS)
def test_the_linear_bench_is_its_linear_model(unit, rng):
    bench = Hexapod(unit=unit, linear=True)
    u = 5.0 * rng.normal(size=(6, 600))
    y = bench.run(u).outputs
    model = bench.linear_model().simulate(u)
    assert np.abs(y - model).max() < 1e-9 * np.abs(model).max()


def test_commands_act_one_sample_late_and_disturbances_at_once():
    bench = Hexapod(linear=True)
    pulse = np.zeros((6, 50))
    pulse[2, 10] = 1.0
    by_command, by_disturbance = bench.run(pulse).outputs, bench.run(0 * pulse, pulse).outputs
    assert not by_disturbance[:, :11].any()
    assert by_disturbance[2, 11] != 0.0
    assert not by_command[:, :12].any()
    assert np.array_equal(by_command[:, 1:], by_disturbance[:, :-1])


def test_the_record_shows_the_delay_a_controller_meets(rng):
    """u = actuation + K y in the sample of y; with no further minus sign."""
    bench = Hexapod(linear=True)
    D = rng.normal(size=(6, 6))
    D *= 0.05 / np.linalg.norm(D, 2)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), D, rate_hz=RATE)
    u = rng.normal(size=(6, 300))
    record = bench.run(u, controller=law)
    assert np.allclose(record.inputs, u + D @ record.outputs, atol=1e-12)
    assert np.allclose(record.outputs, bench.linear_model().simulate(record.inputs), atol=1e-9)


def test_runs_draw_fresh_noise_and_benches_repeat_them(seed):
    u = np.zeros((6, 500))
    first, second = Hexapod(seed=seed), Hexapod(seed=seed)
    a, b = first.run(u), first.run(u)
    assert a.hash != b.hash
    assert (a.hash, b.hash) == (second.run(u).hash, second.run(u).hash)
    assert Hexapod(seed=seed).run(u, run_index=1).hash == b.hash
    assert Hexapod(seed=seed + 1).run(u).hash != a.hash


def test_noise_and_converter(seed):
    bench = Hexapod(seed=seed)
    y = bench.run(np.zeros((6, 20000))).outputs
    step = 10.0 / 2047
    # Rounding adds the variance step^2 / 12 of an even error.
    expected = np.sqrt(0.01**2 + step**2 / 12)
    print(f"noise {y.std(axis=1)} V, {expected:.5f} expected")
    assert np.abs(y.std(axis=1) / expected - 1).max() < 6 / np.sqrt(2 * 20000)
    assert np.abs(y / step - np.round(y / step)).max() < 1e-9
    assert np.abs(np.corrcoef(y) - np.eye(6)).max() < 6 / np.sqrt(20000)
    sixteen = Hexapod(seed=seed, adc_bits=16).run(np.zeros((6, 20000))).outputs
    assert np.unique(sixteen).size > 10 * np.unique(y).size
    assert not Hexapod(seed=seed, noise=False).run(np.zeros((6, 100))).outputs.any()


@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_a_60_hz_sine_of_25_v_clips_at_10_v(unit):
    """Fig. 10 of the paper."""
    u = signals.on_actuator(signals.Tone(60.0, 25.0).generate(4096, 3500.0), actuator=1, actuators=6)
    record = Hexapod(unit=unit).run(u)
    clipped = record.clipped()
    print(
        f"{unit}: {clipped[1]} of 4096 samples of sensor 2 clipped, largest elsewhere "
        f"{np.delete(np.abs(record.outputs).max(axis=1), 1).max():.2f} V"
    )
    assert np.abs(record.outputs).max() == 10.0
    assert clipped[1] > 500
    assert sum(clipped) == clipped[1]
    assert record.provenance.settings["limited_readings"] == list(clipped)
    assert not any(record.provenance.settings["limited_commands"])


def test_limits_are_met_and_counted():
    bench = Hexapod(noise=False)
    u, d = np.zeros((6, 40)), np.zeros((6, 40))
    u[0, 5:8] = 40.0
    d[1, 3] = -500.0
    d[0, 6] = 60.0  # with the held 25 V: 85 V, beyond the 82.5 V left above the bias
    record = bench.run(u, d)
    assert record.inputs.max() == 25.0
    held = record.provenance.settings
    assert held["limited_commands"] == [3, 0, 0, 0, 0, 0]
    assert held["limited_stacks"] == [1, 1, 0, 0, 0, 0]
    assert bench.actuators[0].high == 25.0
    assert bench.sensors[0].high == 10.0
    assert Hexapod(linear=True).run(u, d).inputs.max() == 40.0


def test_it_is_a_registered_bench_with_named_channels():
    bench = Hexapod()
    assert isinstance(bench, Bench)
    assert methods("bench")["hexapod"] is Hexapod
    assert bench.rate_hz == RATE
    record = bench.run(np.zeros((6, 3)))
    assert [c.name for c in record.actuators] == [f"strut {i}" for i in range(1, 7)]
    assert record.sensors[5].unit == "V"
    assert record.provenance.settings["unit"] == "ground"


def test_a_bench_is_its_settings_and_travels_with_its_count():
    bench = Hexapod(unit="flight", seed=3)
    settings = asdict(bench)
    quiet = np.zeros((6, 20))
    first = bench.run(quiet)
    assert asdict(bench) == settings
    assert bench == Hexapod(unit="flight", seed=3)
    copy = pickle.loads(pickle.dumps(bench))
    assert copy.run(quiet).hash == bench.run(quiet).hash
    assert bench.run(quiet, run_index=0).hash == first.hash


class Broken:
    rate_hz = None

    def __init__(self, answer):
        self.answer = answer

    def reset(self):
        pass

    def step(self, y):
        return self.answer


def law_of(rate_hz, ny=6, nu=6):
    return StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), np.zeros((nu, ny)), rate_hz=rate_hz)


QUIET = np.zeros((6, 10))
NAN = np.full((6, 10), np.nan)
BAD = [
    (lambda b: b.run(NAN), InputError, "'actuation' has 60 NaN"),
    (lambda b: b.run(np.zeros((5, 10))), InputError, r"shape \(6, samples\), got \(5, 10\)"),
    (lambda b: b.run(np.zeros(10)), InputError, "2 dimensions"),
    (lambda b: b.run(np.zeros((6, 0))), InputError, r"got \(6, 0\)"),
    (lambda b: b.run("loud"), InputError, "real array"),
    (lambda b: b.run(QUIET, disturbance=NAN), InputError, "'disturbance' has 60 NaN"),
    (lambda b: b.run(QUIET, disturbance=np.zeros((6, 9))), InputError, "shape of 'actuation'"),
    (
        lambda b: b.run(QUIET, controller=law_of(1000.0)),
        RateError,
        "sampled at 1000 Hz but the bench is sampled at 3500",
    ),
    (lambda b: b.run(QUIET, controller=law_of(None)), RateError, "in continuous time"),
    (lambda b: b.run(QUIET, controller=law_of(RATE, ny=5)), InputError, "from 5 to 6"),
    (lambda b: b.run(QUIET, controller=lambda y: y), InputError, "step.y. and reset"),
    (lambda b: b.run(QUIET, controller=SteppedController(law_of(10.0))), RateError, "sampled at 10 Hz"),
    (lambda b: b.run(QUIET, controller=Broken(np.zeros(5))), InputError, "at sample 0 the controller must return 6"),
    (lambda b: b.run(QUIET, controller=Broken([np.inf] * 6)), InputError, "6 finite commands"),
    (lambda b: b.run(QUIET, run_index=-1), InputError, "'run_index' must be at least 0"),
    (lambda b: Hexapod(unit="lunar"), InputError, "one of 'ground', 'flight', 'rigid', got 'lunar'"),
    (lambda b: Hexapod(seed=-1), InputError, "'seed'"),
    (lambda b: Hexapod(adc_bits=2), InputError, "between 4 and 32"),
]


@pytest.mark.parametrize("case", BAD, ids=[c[2] for c in BAD])
def test_bad_input_is_refused_in_one_sentence(case):
    call, kind, words = case
    with pytest.raises(kind, match=words) as caught:
        call(Hexapod())
    assert str(caught.value).endswith(".")


def test_ten_seconds_with_a_60_state_controller_take_half_a_second(rng):
    bench, law = Hexapod(), some_law(rng, states=60)
    u = signals.MAXIMUM_V * rng.uniform(-1, 1, size=(6, 35000))
    bench.run(u[:, :10], controller=law)
    spent = []
    for _ in range(3):
        start = time.process_time()
        bench.run(u, controller=law)
        spent.append(time.process_time() - start)
    print(f"10 s simulated in {min(spent):.3f} s")
    assert min(spent) < 0.5
