"""The real-time frame: instants by hand, overruns as the code counts them, ramp and recovery, twin against code."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from deploy_laws import RATE_HZ

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.cli.deploy.frame import requested_frame, show_frames
from ultraquiet.deploy import Frame, FrameTimes, Overload, generate
from ultraquiet.deploy.frame.settings import BURST_EVERY, BURST_FRAMES
from ultraquiet.deploy.law.twin import FAULT, FAULT_OVERRUN, ON
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.values import StateSpace

T = 1.0 / RATE_HZ
TIMES = FrameTimes(1e-6, 3e-6, 20e-6, 4e-6, 30e-6, 2e-6, idle_output_s=5e-6, idle_update_s=1e-6)
ARRAYS = ("start_s", "written_s", "finish_s", "done_s", "largest_v")
COUNTS = ("skipped", "late", "mode", "faults", "level", "overruns")
RAMP = 40


@pytest.fixture
def made(law_of, tmp_path):
    return generate(law_of(6), tmp_path / "code", ramp_s=RAMP * T)


def without_compiler(monkeypatch):
    monkeypatch.setattr(compiler, "compiler", lambda: None)


def test_instants_of_an_undisturbed_frame(made):
    """start = tick, written after entry, read, output and write, finish after update, background after the return."""
    found = Frame(load=0.5).simulate(made, 50, times=TIMES)
    expected = {"start_s": 0.0, "written_s": 28e-6, "finish_s": 58e-6, "done_s": 60e-6 + 0.5 * T}
    for name, value in expected.items():
        measured = getattr(found, name)
        print(name, f"{1e6 * measured.mean():.3f} us, by hand {1e6 * value:.3f}")
        np.testing.assert_allclose(measured, value, atol=1e-14)
    assert found.utilisation == pytest.approx(60e-6 / T + 0.5)
    assert found.slack_s == pytest.approx(T - 58e-6)
    assert (found.overrun_count, found.late_count, found.refused, found.status.word) == (0, 0, 0, "ok")


@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("jitter", ["uniform", "gaussian", "bursts"])
def test_no_overrun_at_nominal_load(made, seed, jitter):
    """Half a frame of background work, jitter, contention, other interrupts: nothing is late in 1e5 frames."""
    frame = Frame(load=0.5, jitter_s=5e-6, jitter=jitter, contention=0.1)
    found = frame.simulate(made, 100_000, times=TIMES, seed=seed)
    longest = TIMES.entry_s + 1.1 * (TIMES.read_s + TIMES.output_s + TIMES.write_s + TIMES.update_s)
    late = float(np.nanmax(found.start_s))
    print(jitter, found.status, f"worst end {1e6 * found.worst_s:.3f} us, bound {1e6 * (late + longest):.3f}")
    assert found.status.ok
    assert (found.overrun_count, found.late_count, found.hooked, found.refused) == (0, 0, 0, 0)
    assert 0.95 * longest < found.worst_s <= late + longest + 1e-12
    assert found.mode.min() == found.mode.max() == ON
    assert found.level[-1] == RAMP


@pytest.mark.usefixtures("cc")
def test_single_overruns_are_counted_and_do_not_stop_the_law(made):
    """Three late steps far apart, and three skipped frames in a row: counter and hook see each, control goes on."""
    overloads = (*(Overload(k, 1, T) for k in (100, 200, 300)), Overload(400, 1, 3 * T))
    found = Frame(overloads=overloads).simulate(made, 600, times=TIMES)
    print(found.status, np.flatnonzero(found.skipped))
    assert np.flatnonzero(found.skipped).tolist() == [101, 201, 301, 401, 402, 403]
    np.testing.assert_array_equal(found.overruns, np.cumsum(found.skipped))
    assert (found.hooked, found.overrun_count, found.refused) == (6, 6, 0)
    assert np.all(found.mode == ON)
    assert not found.faults.any()
    assert found.status.word == "overrun"


@pytest.mark.usefixtures("cc")
def test_overruns_in_a_row_ramp_out_and_the_law_recovers(made):
    """OVERRUN_LIMIT frames found busy by one step: fault at the next step, ramp to zero, back after the restart."""
    limit, first, restart = made.law.overrun_limit, 100, 30
    frame = Frame(overloads=(Overload(first, 1, limit * T),), restart_s=restart * T)
    found = frame.simulate(made, 400, times=TIMES)
    fault = first + limit + 1
    print(found.status, f"fault at {np.flatnonzero(found.mode == FAULT)[0]}")
    assert np.flatnonzero(found.skipped).tolist() == list(range(first + 1, fault))
    assert np.flatnonzero(found.mode == FAULT)[0] == fault
    assert found.faults[fault] == FAULT_OVERRUN
    np.testing.assert_array_equal(found.level[fault : fault + RAMP], np.arange(RAMP - 1, -1, -1))
    # The last good command, scaled by the ramp's level.
    ramp = found.largest_v[fault : fault + RAMP]
    np.testing.assert_allclose(ramp, found.largest_v[fault - 1] * np.arange(RAMP - 1, -1, -1) / RAMP, rtol=1e-6)
    # The ramp is longer than the restart: back in control as soon as it has ended, and at full level one ramp later.
    back = fault + RAMP
    assert np.all(found.mode[fault:back] == FAULT)
    assert np.all(found.mode[back:] == ON)
    np.testing.assert_array_equal(found.level[back : back + RAMP], np.arange(1, RAMP + 1))
    assert found.faults[back] == 0
    assert (found.overrun_count, found.hooked, found.refused) == (limit, limit, 0)


@pytest.mark.usefixtures("cc")
def test_without_a_restart_the_law_stays_out(made):
    limit = made.law.overrun_limit
    found = Frame(overloads=(Overload(100, 1, limit * T),)).simulate(made, 400, times=TIMES)
    print(found.status)
    assert np.all(found.mode[100 + limit + 1 :] == FAULT)
    assert found.largest_v[-1] == 0.0
    assert "in fault" in found.status.sentence


@pytest.mark.usefixtures("cc")
def test_lasting_overload_of_every_other_frame(made):
    """A step of one and a half periods: every other frame is skipped, the fault comes, then guards alone fit."""
    limit = made.law.overrun_limit
    slow = replace(TIMES, update_s=1.5 * T)
    found = Frame(load=0.1).simulate(made, 500, times=slow)
    fault = int(np.flatnonzero(found.mode == FAULT)[0])
    print(found.status, f"{found.overruns[fault]} overruns before the fault, limit {limit}")
    assert limit < found.overruns[fault] <= 2 * limit
    np.testing.assert_array_equal(np.flatnonzero(found.skipped[:fault]), np.arange(1, fault, 2))
    # The step that latches the fault was begun in control and takes its full time once more.
    assert found.overrun_count <= found.overruns[fault] + 1
    assert not found.skipped[fault + 2 :].any()
    assert "longer than the frame" in found.status.sentence


@pytest.mark.usefixtures("cc")
def test_code_and_twin_pass_the_same_instants_and_modes(law_of, rng, tmp_path, monkeypatch, seed):
    """Everything at once: the compiled code in the C harness, the twin in the plain clock, bit for bit."""
    form = str(rng.choice(["modal", "delta", "schur", "dense"]))
    states = int(rng.integers(1, 20))
    made = generate(law_of(states), tmp_path / "code", form=form, ramp_s=20 * T)
    first = int(rng.integers(50, 400))
    frame = Frame(
        load=float(rng.uniform(0.2, 0.8)),
        jitter_s=float(rng.uniform(0.0, 0.9)) * T,
        jitter=str(rng.choice(["uniform", "gaussian", "bursts"])),
        contention=float(rng.uniform(0.0, 2.0)),
        interrupt_hz=2000.0,
        interrupt_s=20e-6,
        overloads=(Overload(first, 60, float(rng.uniform(0.5, 3.0)) * T), Overload(first + 500, 3, 4 * T)),
        restart_s=50 * T,
    )
    code = frame.simulate(made, 1500, times=TIMES, seed=seed)
    without_compiler(monkeypatch)
    twin = frame.simulate(made, 1500, times=TIMES, seed=seed)
    print(form, code.status, code.ran, twin.ran)
    assert (code.ran, twin.ran) == ("compiled code", "twin")
    assert code.overrun_count > 0
    assert code.refused == twin.refused == 0
    for name in (*ARRAYS, *COUNTS):
        np.testing.assert_array_equal(getattr(code, name), getattr(twin, name), err_msg=name)


@pytest.mark.usefixtures("cc")
def test_other_interrupts_stretch_a_step_by_their_share(made, seed):
    """Work w under interrupts of share r lasts w / (1 - r) on average."""
    share = 0.2
    frame = Frame(load=0.3, interrupt_hz=20_000.0, interrupt_s=share / 20_000.0)
    found = frame.simulate(made, 100_000, times=TIMES, seed=seed)
    lasted = float(np.mean(found.finish_s - found.start_s))
    expected = 58e-6 / (1 - share)
    print(f"{1e6 * lasted:.3f} us, expected {1e6 * expected:.3f}")
    assert found.overrun_count == 0
    assert lasted == pytest.approx(expected, rel=0.004)


@pytest.mark.usefixtures("cc")
def test_background_is_late_where_the_step_takes_its_half(made):
    """No overrun, but the step leaves less than the background needs, by 10 us a frame."""
    slow = replace(TIMES, update_s=0.5 * T + 10e-6 - 30e-6)
    found = Frame(load=0.5).simulate(made, 1000, times=slow)
    fits = Frame(load=0.5).simulate(made, 1000, times=replace(slow, update_s=slow.update_s - 10.1e-6))
    print(found.status)
    assert (found.overrun_count, found.late_count) == (0, 1000)
    assert found.status.word == "background late"
    assert found.table["worst_background_end_us"] == "late"
    assert fits.status.ok


@pytest.mark.parametrize(
    ("jitter", "mean"), [("uniform", 0.5), ("gaussian", np.sqrt(2 / np.pi)), ("bursts", 0.5 * BURST_FRAMES)]
)
def test_jitter_has_the_size_it_is_asked_for(seed, jitter, mean):
    delay = Frame(jitter_s=5e-6, jitter=jitter).draw(1_000_000, T, seed).delay_s
    if jitter == "bursts":
        mean /= BURST_EVERY
        ran = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], delay > 0, [0]]))))[::2]
        assert ran.min() >= min(BURST_FRAMES, ran[-1])
    print(jitter, f"mean {delay.mean() / 5e-6:.4f} of the size, expected {mean:.4f}")
    assert delay.min() >= 0.0
    assert delay.max() < T
    assert delay.mean() / 5e-6 == pytest.approx(mean, rel=0.2 if jitter == "bursts" else 0.01)


@pytest.mark.usefixtures("cc")
def test_on_a_bench_a_frame_in_time_changes_no_bit(law_of, rng, tmp_path, seed):
    law = law_of(12)
    made = generate(StateSpace(law.A, 0.05 * law.B, law.C, 0.05 * law.D, rate_hz=RATE_HZ), tmp_path / "code")
    u = 0.1 * rng.standard_normal((6, 700))
    overload = Frame(overloads=(Overload(50, 600, 1.2 * T),)).controller(made)
    framed = Frame(load=0.5, jitter_s=5e-6).controller(made)
    laws = (made.controller, framed, overload)
    plain, same, late = (uq.bench.Hexapod(unit="ground", seed=seed).run(u, controller=k).outputs for k in laws)
    changed = np.flatnonzero((late != plain).any(axis=0))
    print(f"{overload.overruns} overruns under overload, its first other sample is {changed[0]}")
    np.testing.assert_array_equal(same, plain)
    assert framed.overruns == 0
    assert overload.overruns >= made.law.overrun_limit
    assert changed[0] > 50


@pytest.mark.parametrize("compiled", [True, False])
def test_a_late_command_is_applied_a_sample_later(made, monkeypatch, request, compiled):
    """The converters are written in the second period of each step: the frame in between returns the new command."""
    if compiled:
        request.getfixturevalue("cc")
    else:
        without_compiler(monkeypatch)
    law = Frame(load=0.0).controller(made, times=replace(TIMES, output_s=1.2 * T))
    first = np.full(6, 0.01)
    commands = [law.step(first).copy() for _ in range(3)]
    made.controller.reset()
    expected = made.controller.step(first)
    assert not commands[0].any()
    np.testing.assert_array_equal(commands[1], expected)
    np.testing.assert_array_equal(commands[2], expected)
    assert law.overruns == 1


def test_times_of_the_c31_model_are_its_cycles(law_of, tmp_path):
    made = generate(law_of(60), tmp_path / "code", form="modal")
    times = FrameTimes.c31(made.law)
    print(f"{1e6 * times.step_s:.2f} us for {made.tables['c31_cycles']} cycles, latency {1e6 * times.latency_s:.2f} us")
    assert times.step_s == pytest.approx(50e-9 * made.tables["c31_cycles"], rel=1e-12)
    assert times.skeleton_s == pytest.approx(142 * 50e-9, rel=1e-12)


@pytest.mark.gate("cortex-m7")
@pytest.mark.skipif(missing_program() is not None, reason=f"'{missing_program()}' is not installed")
@pytest.mark.parametrize("target", ["cortex-m7", "cortex-m4f"])
def test_times_of_a_cortex_are_counted(made, target):
    times = FrameTimes.on_target(made, target, cycles_per_instruction=2.0)
    found = Frame(load=0.5, jitter_s=5e-6).simulate(made, 10_000, times=times)
    print(times.source, f"step {1e6 * times.step_s:.2f} us, off {1e6 * times.idle_output_s:.2f} us", found.status)
    assert 0 < times.idle_output_s < times.output_s
    assert 0 < times.idle_update_s < times.update_s
    assert found.status.ok


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"load": 1.0}, "'load' must lie below 1, got 1"),
        ({"load": -0.1}, "'load' must lie between 0 and inf, got -0.1"),
        ({"load": np.nan}, "'load' must be finite"),
        ({"jitter_s": -1e-6}, "'jitter_s' must lie between 0 and inf s"),
        ({"jitter": "pink"}, "'jitter' must be one of 'uniform', 'gaussian', 'bursts', got 'pink'"),
        ({"contention": -1.0}, "'contention' must lie between"),
        ({"load": 0.5, "interrupt_hz": 1e5, "interrupt_s": 6e-6}, "leave nothing of the processor to the step"),
        ({"restart_s": 0.0}, "'restart_s' must be above zero s"),
    ],
)
def test_settings_that_cannot_be(settings, sentence):
    with pytest.raises(InputError, match=sentence.replace("(", r"\(")):
        Frame(**settings)


def test_runs_that_cannot_be(made):
    for call, sentence in (
        (lambda: Frame(jitter_s=T).simulate(made, 10), "a jitter of 285.714 us is not below the frame's 285.7 us"),
        (lambda: Frame().simulate(made, 0), "'frames' must be between 1 and"),
        (lambda: Frame().simulate(made, 10, times=replace(TIMES, read_s=T)), "shorter than its skeleton"),
        (lambda: Frame().simulate(made, 10, measurements=np.zeros((2, 5))), r"measurements must be \(6, n\), got"),
        (lambda: Frame(overloads=(Overload(10, 1, T),)).simulate(made, 10), "begins at frame 10, the run has only 10"),
        (lambda: Overload(0, 1, 0.0), "'extra_s' must be above zero s"),
        (lambda: FrameTimes.counted(10, 10, 0.0), "'clock_hz' must be above zero Hz"),
        (lambda: FrameTimes(-1e-6, 0, 0, 0, 0, 0), "'entry_s' must lie between 0 and 1 s"),
    ):
        with pytest.raises(InputError, match=sentence):
            call()


@pytest.mark.usefixtures("cc")
def test_command_line_prints_time_line_and_table(made, tmp_path, capsys):
    frame = requested_frame(RATE_HZ, "c31", 20_000, 0.5, 5.0, "1000:300:500")
    show_frames(made, frame, 20_000, "c31", tmp_path / "frame.svg")
    said = capsys.readouterr().out
    found = frame.simulate(made, 20_000)
    named = ("a step takes", "left before the next tick (us)")
    for word in ("converters read", "output", "update", "next interrupt", "overrun: ", *named):
        assert word in said
    assert f"{found.overrun_count} of 20000 frames overran" in said
    assert (tmp_path / "frame.svg").read_text().startswith("<svg")
    assert "was skipped" in found.timeline(int(np.flatnonzero(found.skipped)[0]))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"processor": "dsp56k"}, f"'frame_on' must be one of {', '.join(map(repr, ('c31', *TARGETS)))}, got 'dsp56k'"),
        ({"frames": 0}, "'frames' must be between 1 and"),
        ({"load": 1.0}, "'load' must lie below 1"),
        ({"jitter_us": 300.0}, "a jitter of 300 us is not below the frame's 285.7 us"),
        ({"overload": "1000:300"}, "FIRST:FRAMES:MICROSECONDS, 1000:300:500 say, got '1000:300'"),
        ({"overload": "5:1:-2"}, "'extra_s' must be above zero s"),
    ],
)
def test_command_line_refuses_before_it_writes(settings, sentence):
    usual = {"processor": "c31", "frames": 1000, "load": 0.5, "jitter_us": 0.0, "overload": None}
    with pytest.raises(InputError, match=sentence):
        requested_frame(RATE_HZ, **(usual | settings))


@pytest.mark.usefixtures("cc")
def test_time_line_of_a_frame_fills_it_in_order(made):
    """The parts follow each other without a gap; background begins after the return from the interrupt."""
    found = Frame(jitter_s=20e-6).simulate(made, 100, times=TIMES)
    for k in (0, found.worst_frame, 99):
        spans = found.spans_us(k)
        print(found.timeline(k))
        gaps = np.array([b[1] - a[2] for a, b in pairwise(spans)])
        np.testing.assert_allclose(gaps, [0.0] * (len(gaps) - 1) + [1e6 * TIMES.leave_s], atol=1e-6)
        np.testing.assert_allclose(spans[-1][2], 1e6 * found.done_s[k])
