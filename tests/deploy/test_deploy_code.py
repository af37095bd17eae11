"""The code against its twin, bit by bit, and its guards seen from outside."""

import pickle
import subprocess
import time

import numpy as np
import pytest
from deploy_laws import RATE_HZ

from ultraquiet._base.errors import InputError
from ultraquiet.bench import Hexapod
from ultraquiet.deploy import generate
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.deploy.verification.verify import compare, measurements
from ultraquiet.simulate.payload.wires import on_all_channels
from ultraquiet.values import Controller, StateSpace, SteppedController

pytestmark = pytest.mark.usefixtures("cc")


def settle(rng, law, volts):
    """Measurements whose linear commands peak at `volts`."""
    y = rng.standard_normal((law.D.shape[1], 400))
    return y * volts / np.abs(law.simulate(y)).max()


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_hundred_thousand_steps_bit_for_bit(law_of, seed, tmp_path, precision):
    made = generate(law_of(60), tmp_path / "code", precision=precision)
    assert made.tables["bit_exact"] is None
    found = made.verify(steps=100_000, seed=seed)
    print(f"{precision}: {found.status} {found.seconds:.1f} s")
    assert found.ok
    assert found.bit_exact is True
    assert found.mismatches == 0
    assert found.self_test is True
    assert made.tables["bit_exact"] is True


@pytest.mark.gate(
    "modal-True-float32", "modal-False-float64", "delta-False-float32", "schur-True-float64", "dense-False-float32"
)
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("anti_windup", [False, True])
@pytest.mark.parametrize("form", ["modal", "delta", "schur", "dense"])
def test_every_form_bit_for_bit(law_of, rng, seed, tmp_path, form, anti_windup, precision):
    law = law_of(int(rng.integers(0, 25)), int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    made = generate(law, tmp_path / "code", precision, form=form, anti_windup=anti_windup, ramp_s=0.02)
    found = made.verify(steps=3000, seed=seed, targets=(), fuzz_steps=0)
    assert found.ok, (found.status, law.A.shape, law.D.shape)


def test_long_verification_visits_limits_ramp_and_fault(law_of, seed, tmp_path):
    plan = generate(law_of(12), tmp_path / "code", ramp_s=0.01).plan
    law, y = plan.law, measurements(plan, 5000, seed)
    twin = Twin(law)
    twin.enable()
    u = twin.run(y)
    assert twin.faults == 1
    assert 50 < twin.clipped < 5000
    assert np.all(u[:, -5:] == 0)
    assert np.abs(u[:, 0]).max() < np.abs(u).max() / 10


def test_a_changed_coefficient_is_found(law_of, tmp_path):
    made = generate(law_of(6), tmp_path / "code")
    path = tmp_path / "code" / "controller_coefficients.h"
    text = path.read_text()
    table = text.index("/* D: ")
    digit = text.index("0x1.", table) + len("0x1.")
    changed = "0" if text[digit] != "0" else "8"
    path.write_text(text[:digit] + changed + text[digit + 1 :])
    found = made.verify(steps=2000, targets=(), fuzz_steps=0)
    print(found.status)
    assert found.bit_exact is False
    assert found.status.word == "differs"
    assert found.first is not None
    assert found.self_test is False


def test_a_law_that_does_not_compile_is_reported_not_raised(law_of, tmp_path):
    made = generate(law_of(4), tmp_path / "code")
    (tmp_path / "code" / "controller.c").write_text("int x = ;\n")
    found = made.verify(steps=10)
    assert found.status.word == "not compiled"
    assert "refused the generated code" in found.status.sentence
    assert found.bit_exact is None


@pytest.mark.parametrize("level", ["-O0", "-O3"])
def test_optimiser_changes_no_bit(law_of, seed, tmp_path, cc, level):
    made = generate(law_of(24), tmp_path / "code", ramp_s=0.01)
    y = measurements(made.plan, 2000, seed)
    flags = tuple(level if f == "-O2" else f for f in FLAGS)
    runs = [CompiledController(Library(made.law, made.folder, cc, f)).run(y) for f in (FLAGS, flags)]
    assert compare(*runs) == (0, None)


def test_controller_follows_the_designed_law(law_of, rng, tmp_path):
    law = law_of(40)
    y = settle(rng, law, 20.0)
    runs = generate(law, tmp_path / "a").controller
    assert isinstance(runs, Controller)
    plain = SteppedController(law)
    code = np.stack([runs.step(k) for k in y.T], axis=1)
    exact = np.stack([plain.step(k) for k in y.T], axis=1)
    error = np.abs(code - exact).max() / np.abs(exact).max()
    print(f"float32 against float64 law: {error:.1e}")
    assert runs.rate_hz == RATE_HZ
    assert error < 1e-4
    precise = generate(law, tmp_path / "b", "float64").controller
    assert np.allclose(np.stack([precise.step(k) for k in y.T], axis=1), exact, atol=1e-9)


def test_reset_repeats_the_run(law_of, rng, tmp_path):
    runs = generate(law_of(8), tmp_path / "code").controller
    y = rng.standard_normal((50, 6))
    first = [runs.step(k) for k in y]
    runs.reset()
    assert np.array_equal(first, [runs.step(k) for k in y])


@pytest.mark.slow
def test_instances_do_not_touch_each_other(law_of, rng, tmp_path):
    made = generate(law_of(8), tmp_path / "code")
    other = generate(law_of(8), tmp_path / "other")
    y = rng.standard_normal((60, 6))
    alone = made.instance().step(y[0])
    one, two, three = made.instance(), made.instance(), other.instance()
    mixed, lagging = [], []
    for k in range(60):
        mixed.append(one.step(y[k]))
        three.step(y[k])
        if k >= 7:
            lagging.append(two.step(y[k - 7]))
    assert np.array_equal(mixed[0], alone)
    assert made.controller is made.controller
    assert np.array_equal(lagging, mixed[:53])


def test_commands_stay_within_asymmetric_limits(law_of, rng, tmp_path):
    law = law_of(10, 6, 3)
    limits = [[-1.0, 2.0], [-15.0, 150.0], [0.0, 3.0]]
    runs = generate(law, tmp_path / "code", limits_v=limits).controller
    u = np.stack([runs.step(k) for k in 20 * settle(rng, law, 150.0).T], axis=1)
    assert np.array_equal(u.min(axis=1), [-1.0, -15.0, 0.0])
    assert np.array_equal(u.max(axis=1), [2.0, 150.0, 3.0])


def test_start_is_bumpless_and_ramps_in_on_time(law_of, tmp_path):
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2), rate_hz=RATE_HZ)
    made = generate(gain, tmp_path / "code", limits_v=10.0, ramp_s=0.1)
    runs = made.instance(ramp=True)
    u = np.stack([runs.step(np.array([4.0, 40.0])) for _ in range(400)], axis=1)
    ramp = np.minimum(np.arange(1, 401) / 350.0, 1.0)
    assert np.allclose(u[0], 4.0 * ramp, rtol=1e-6)
    assert np.allclose(u[1], 10.0 * ramp, rtol=1e-6)
    runs.disable()
    down = np.stack([runs.step(np.array([4.0, 40.0])) for _ in range(360)], axis=1)
    assert np.allclose(down[1], 10.0 * np.maximum(1 - np.arange(1, 361) / 350.0, 0.0), rtol=1e-5, atol=1e-5)
    assert np.all(down[:, -10:] == 0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_measurement_latches_and_ramps_the_last_command_out(law_of, rng, tmp_path, bad):
    law = law_of(10)
    runs = generate(law, tmp_path / "code", ramp_s=0.1).controller
    y = settle(rng, law, 20.0)
    for k in y[:, :100].T:
        before = runs.step(k)
    hit = y[:, 100].copy()
    hit[rng.integers(6)] = bad
    after = np.stack([runs.step(hit), *(runs.step(k) for k in y[:, 101:].T)], axis=1)
    again = np.stack([runs.step(k) for k in y.T], axis=1)
    ramp = np.maximum(1 - np.arange(1, 301) / 350.0, 0.0)
    assert np.allclose(after, before[:, None] * ramp, rtol=1e-5, atol=1e-5)
    assert np.all(np.isfinite(again))
    assert np.all(again[:, 50:] == 0)


def test_unstable_law_is_generated_with_a_warning_and_never_leaves_the_limits(rng, tmp_path):
    law = StateSpace([[1.02]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    made = generate(law, tmp_path / "code", limits_v=25.0, ramp_s=0.01)
    assert made.status.word == "unstable"
    runs = made.controller
    u = np.array([runs.step(np.array([1.0]))[0] for _ in range(20_000)])
    assert np.all(np.isfinite(u))
    assert np.abs(u).max() == 25.0
    assert u[-1] == 0.0  # float32 overflowed: fault, ramped out
    assert made.verify(steps=5000, targets=(), fuzz_steps=0).ok


def test_make_check_passes_in_the_folder(law_of, tmp_path):
    generate(law_of(6), tmp_path / "code", name="iso_6")
    told = subprocess.run(["make", "check"], cwd=tmp_path / "code", capture_output=True, text=True, check=False)
    print(told.stdout)
    assert told.returncode == 0, told.stderr
    assert "self-test passed" in told.stdout


def test_vectors_are_what_the_code_computes(law_of, tmp_path):
    made = generate(law_of(9), tmp_path / "code")
    lines = (tmp_path / "code" / "vectors.csv").read_text().splitlines()
    held = np.array([[float.fromhex(v) for v in line.split(",")] for line in lines[1:]])
    runs = made.instance()
    assert held.shape == (256, 12)
    assert np.array_equal(np.stack([runs.step(k) for k in held[:, :6]]), held[:, 6:])


def test_a_pickled_controller_runs_from_rest(law_of, rng, tmp_path):
    runs = generate(law_of(8), tmp_path / "code").controller
    y = rng.standard_normal((20, 6))
    first = [runs.step(k) for k in y]
    copy = pickle.loads(pickle.dumps(runs))
    assert np.array_equal(first, [copy.step(k) for k in y])


def test_code_closes_the_loop_as_the_law_does(law_of, rng, tmp_path):
    """A plant whose loop is stable by small gain, disturbed at its input; the code against the float64 law."""
    plant, law = law_of(12), law_of(24)
    f_hz = np.geomspace(0.05, 1750.0, 4000)
    loop = np.einsum("ijf,jkf->ikf", plant.frequency_response(f_hz), law.frequency_response(f_hz))
    share = 0.9 / np.linalg.norm(loop, 2, axis=(0, 1)).max()
    law = StateSpace(law.A, law.B, share * law.C, share * law.D, rate_hz=RATE_HZ)
    disturbance = rng.standard_normal((6, 3000))
    open_loop = StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), np.zeros((6, 6)), rate_hz=RATE_HZ)
    outputs = []
    for controller in (
        SteppedController(open_loop),
        SteppedController(law),
        generate(law, tmp_path / "code", limits_v=1e6).controller,
    ):
        x, u, heard = np.zeros(12), np.zeros(6), []
        for d in disturbance.T:
            y = plant.C @ x + plant.D @ (u + d)
            x = plant.A @ x + plant.B @ (u + d)
            u = controller.step(y)  # reaches the plant one sample later
            heard.append(y)
        outputs.append(np.array(heard))
    effect, error = (np.linalg.norm(one - outputs[1]) / np.linalg.norm(outputs[1]) for one in (outputs[0], outputs[2]))
    print(f"closed loop: the law changes {effect:.1e} of the output, float32 code differs from it by {error:.1e}")
    assert error < 1e-3 * effect


class Asked:
    """A controller that offers no machine code of its own: the bench steps it through Python."""

    def __init__(self, code):
        self.code, self.rate_hz, self.library = code, code.rate_hz, code.library

    def reset(self):
        self.code.reset()

    def step(self, y):
        return self.code.step(y)


@pytest.mark.gate("float32")
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_bench_that_calls_the_code_itself_changes_no_bit(law_of, rng, tmp_path, precision):
    """On the bench's own channels and, with all instruments wired, on some of them; limits are met."""
    code = generate(law_of(8), tmp_path / "code", precision, limits_v=5.0).instance()
    own, full = Hexapod(unit="flight", seed=1), Hexapod(unit="flight", seed=1).instrumented()
    for bench in (own, full):
        sent = rng.uniform(-25.0, 25.0, (2, len(bench.actuators), 700))
        laws = [on_all_channels(law, own, bench, (), "test") for law in (Asked(code), code)]
        plain, called = (bench.run(sent[0], sent[1], controller=law, run_index=3) for law in laws)
        assert np.array_equal(plain.inputs, called.inputs)
        assert np.array_equal(plain.outputs, called.outputs)
        assert laws[1].machine_step().channels == (len(bench.sensors), len(bench.actuators))
    with pytest.raises(InputError, match="at sample 0 the controller must return 6 finite commands"):
        own.run(sent[0][:6], controller=generate(law_of(4, 6, 5), tmp_path / "other").instance())


def test_compiled_steps_are_fast_enough_for_a_simulation(law_of, tmp_path):
    runs = generate(law_of(60), tmp_path / "code").controller
    y = np.zeros(6)
    begun = time.perf_counter()
    for _ in range(2000):
        runs.step(y)
    microseconds = (time.perf_counter() - begun) * 1e6 / 2000
    print(f"{microseconds:.1f} us a step through Python")
    assert microseconds < 285.0  # one frame
