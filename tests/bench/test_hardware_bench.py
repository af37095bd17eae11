"""Real hardware: whatever goes wrong, the actuators come down to zero without a jump, and the error says why."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ultraquiet._base.errors import BenchError, InputError, InterlockError
from ultraquiet.bench import Bench, Hardware, Interlocks, Streaming, Wrapped
from ultraquiet.bench.hardware.pacing import Pacer
from ultraquiet.values import Channel, StateSpace

RATE_HZ, SLEW, AMPLITUDE = 1000.0, 2000.0, 10.0  # 2 V a sample
ACTUATORS = [Channel(f"push {i}", "V", -AMPLITUDE, AMPLITUDE) for i in (1, 2)]
SENSORS = ["speed 1", "speed 2", "speed 3"]


class Lab:
    """A converter card that remembers every value it was told, and can fail."""

    def __init__(self):
        self.written, self.frames = [], 0
        self.fault = lambda k: None  # before a write
        self.late_fault = lambda k: None  # after a write has come through
        self.answer = lambda k, u: [u[0], u[1], u[0] - u[1]]

    def write(self, u):
        k = len(self.written)
        self.fault(k)
        self.written.append(np.array(u))
        self.late_fault(k)
        u[:] = np.nan  # a callback that spoils its argument

    def read(self):
        self.frames += 1
        return self.answer(self.frames - 1, self.written[-1])

    def bench(self, slew=SLEW, wait=lambda: None, **limits):
        limits = {"slew_per_s": slew, "ramp_s": 0.01, **limits}
        return Hardware(self.write, self.read, RATE_HZ, ACTUATORS, SENSORS, Interlocks(**limits), wait)

    def assert_safe(self, slew=SLEW, amplitude=AMPLITUDE):
        sent = np.array([np.zeros(2), *self.written])
        jump = np.abs(np.diff(sent, axis=0)).max(initial=0.0)
        assert np.array_equal(sent[-1], np.zeros(2)), f"left at {sent[-1]}"
        assert jump <= slew / RATE_HZ * (1 + 1e-9), f"a jump of {jump} V"
        assert np.abs(sent).max() <= amplitude
        return jump


def smooth(rng, n, share=0.9, slew=SLEW, amplitude=AMPLITUDE):
    """Two random actuations that keep to a share of slew and amplitude, folded back at the limits."""
    u, top = np.cumsum(rng.uniform(-1, 1, (2, n)) * share * slew / RATE_HZ, axis=1), share * amplitude
    return np.abs((u - top) % (4 * top) - 2 * top) - top


def gathered(stream):
    """The blocks of a stream, and what ended it."""
    blocks = []
    try:
        blocks.extend(stream)
    except BaseException as error:
        return blocks, error
    return blocks, None


def samples(blocks):
    return sum(b.readings.shape[1] for b in blocks)


def test_a_run_is_that_of_the_same_plant_wrapped(rng):
    A, B, C, D = (rng.normal(size=s) for s in ((4, 4), (4, 2), (3, 4), (3, 2)))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()  # a plant that runs away ends at the interlocks

    class Plant:
        def reset(self):
            self.x = np.zeros(4)

        def step(self, u, d):
            y = C @ self.x + D @ (u + d)
            self.x = A @ self.x + B @ (u + d)
            return y

    plant, lab = Plant(), Lab()
    plant.reset()
    inside = Wrapped(plant.step, plant.reset, RATE_HZ, ACTUATORS, SENSORS)
    law = StateSpace([[0.5]], 1e-3 * rng.normal(size=(1, 3)), rng.normal(size=(2, 1)), np.zeros((2, 3)), RATE_HZ)
    u, d = smooth(rng, 200, 0.4), smooth(rng, 200, 0.4)
    for controller in (None, law):
        lab.answer = lambda k, applied: plant.step(applied, np.zeros(2))
        expected = inside.run(u, d, controller)
        plant.reset()
        bench = lab.bench(slew=1e6)
        assert isinstance(bench, Bench)
        assert isinstance(bench, Streaming)
        record = bench.run(u, d, controller)
        assert np.array_equal(record.inputs, expected.inputs)
        assert np.array_equal(record.outputs, expected.outputs)
        lab.assert_safe(slew=1e6, amplitude=2 * AMPLITUDE)
    assert record.provenance.settings["interlocks"]["slew_per_s"] == 1e6


def at_random(rng):
    return int(rng.integers(1, 150))


def raising(kind, at, count=1):
    def fault(k):
        if at <= k < at + count:
            raise kind("cable")

    return fault


FAULTS = {
    "write raises before it acts": (lambda lab, at: setattr(lab, "fault", Shy(OSError, at)), "'write' failed .*cable"),
    "write raises after it acted": (
        lambda lab, at: setattr(lab, "late_fault", raising(OSError, at)),
        "'write' failed .*cable",
    ),
    "read raises": (lambda lab, at: answer(lab, at, OSError), "'read' failed .*cable"),
    "read gives NaN": (lambda lab, at: answer(lab, at, [0.0, np.nan, 0.0]), "'read' must return 3 finite numbers"),
    "read gives two": (lambda lab, at: answer(lab, at, [0.0, 0.0]), "'read' must return 3 finite numbers"),
    "read gives text": (lambda lab, at: answer(lab, at, "off"), "'read' failed .*readings are real numbers"),
    "read gives nothing": (lambda lab, at: answer(lab, at, None), "'read' must return 3 finite numbers|'read' failed"),
}


class Shy:
    """Fails at the write number `at`, the first `times` that it is tried."""

    def __init__(self, kind, at, times=1):
        self.kind, self.at, self.left = kind, at, times

    def __call__(self, k):
        if k == self.at and self.left:
            self.left -= 1
            raise self.kind("cable")


def answer(lab, at, what):
    sane = lab.answer

    def read(k, u):
        if k != at:
            return sane(k, u)
        if isinstance(what, type):
            raise what("cable")
        return what

    lab.answer = read


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_at_zero_without_a_jump_and_keeps_the_record(fault, closed, rng):
    inject, words = FAULTS[fault]
    for _ in range(10):
        lab, at = Lab(), at_random(rng)
        inject(lab, at)
        law = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), 1e-3 * np.ones((2, 3)), RATE_HZ)
        bench = lab.bench()
        blocks, error = gathered(bench.stream(smooth(rng, 200), None, law if closed else None, block_samples=32))
        # The first write of all, of zeros, is number 0; that of frame k is number k + 1.
        k = at if "read" in fault else at - 1
        assert isinstance(error, BenchError)
        with pytest.raises(BenchError, match=rf"Hardware: at sample {k} {words}"):
            raise error
        assert samples(blocks) == k
        jump = lab.assert_safe()
    print(f"{fault}: {samples(blocks)} samples kept, largest jump {jump:.3g} V of {SLEW / RATE_HZ:g} V; {error}")


def test_every_way_down_is_slow_enough(rng):
    jumps = []
    for way in ("end", "stop", "emergency", "close", "interrupt"):
        for _ in range(10):
            lab, at = Lab(), at_random(rng)
            count = iter(range(10**6))
            limits = {"stop": lambda at=at, count=count: next(count) >= at} if way == "emergency" else {}
            bench, u = lab.bench(**limits), smooth(rng, 200)
            if way == "interrupt":
                lab.late_fault = raising(KeyboardInterrupt, at + 1, 3)  # pressed again on the way down
            asked = iter(range(10**6))
            pressed = (lambda at=at, asked=asked: 16 * next(asked) >= at) if way == "stop" else None
            stream = bench.stream(u, block_samples=16, stop=pressed, ramp_samples=3)
            if way == "close":
                blocks = [next(stream) for _ in range(1 + at // 16)]
                stream.close()
                error = None
            else:
                blocks, error = gathered(stream)
            jumps.append(lab.assert_safe())
            if way == "emergency":
                assert isinstance(error, InterlockError)
                assert (error.interlock, error.sample) == ("stop", at)
                assert samples(blocks) == at
            elif way == "interrupt":
                assert isinstance(error, KeyboardInterrupt)
                assert samples(blocks) == at
            else:
                assert error is None
            # And it is free for the next run, unless the button is still pressed.
            assert way == "emergency" or bench.run(u[:, :5]).samples == 5
    print(f"{len(jumps)} ways down: largest jump {max(jumps):.4g} V of {SLEW / RATE_HZ:g} V a sample")


def test_a_soft_stop_is_recorded_as_it_was_sent(rng):
    u, d = smooth(rng, 400, 0.45), smooth(rng, 400, 0.45)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), 1e-3 * np.ones((2, 3)), RATE_HZ)
    for controller in (None, law):
        lab, asked = Lab(), iter([False] * 5 + [True] * 100)
        stream = lab.bench().stream(u, d, controller, block_samples=20, stop=lambda asked=asked: next(asked))
        command = np.concatenate([b.command for b in stream], axis=1)
        n = command.shape[1]
        sent = np.array(lab.written).T[:, 1 : n + 1]
        assert n == 400 or 100 < n < 400
        assert np.allclose(sent[:, 1:101], command[:, :100] + d[:, 1:101], rtol=0, atol=1e-15)
        assert np.allclose(sent[:, 101:n], command[:, 100 : n - 1], rtol=0, atol=1e-15)
        lab.assert_safe()


def refused(limits, u, words, d=None):
    lab = Lab()
    with pytest.raises(InputError, match=words):
        lab.bench(**limits).stream(u, d)
    assert lab.written == []


def test_what_is_known_to_trip_is_refused_before_anything_moves():
    ramp = np.outer([1.0, -1.0], np.arange(6.0))
    refused({"amplitude": 3.0}, ramp, r"sample 5 'push 1' was to be sent 4 V, -3 to 3 V are allowed .*'amplitude'")
    refused({"amplitude": (9.0, 2.0)}, ramp, r"sample 4 'push 2' was to be sent -3 V")
    refused({"slew": 900.0}, ramp, r"'push 1' was to change by 1000 V/s, 900 V/s are allowed by the interlock 'slew'")
    refused({"duration_s": 0.005}, ramp, r"of 0.006 s is longer than the interlock 'duration' allows, 0.005 s")
    refused({"amplitude": 5.0}, ramp, r"sample 4 'push 1' was to be sent 6.6 V", d=0.9 * np.abs(ramp))
    lab = Lab()
    lab.bench(amplitude=5.0, slew=1000.0, duration_s=0.006).run(ramp)  # exactly at the limits
    lab.assert_safe(1000.0, 5.0)


def test_limits_that_do_not_fit_are_refused():
    lab = Lab()
    with pytest.raises(InputError, match="'a' may be sent -inf to inf; it needs finite limits"):
        Hardware(lab.write, lab.read, RATE_HZ, ["a"], ["b"])
    with pytest.raises(InputError, match="finite limits about zero"):
        Hardware(lab.write, lab.read, RATE_HZ, [Channel("a", "V", 1.0, 2.0)], ["b"])
    with pytest.raises(InputError, match="'amplitude' must be one number or 2, got 3"):
        lab.bench(amplitude=(1.0, 2.0, 3.0))
    with pytest.raises(InputError, match="'read' must be a function"):
        Hardware(lab.write, None, RATE_HZ, ACTUATORS, SENSORS)
    for name in ("slew_per_s", "duration_s", "frame_s", "rms"):
        with pytest.raises(InputError, match=f"'{name}' must be above zero"):
            Interlocks(**{name: 0.0})


def gain(k):
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), k * np.eye(2, 3), RATE_HZ)


def test_a_controller_that_runs_away_trips(rng):
    u = np.zeros((2, 500))
    u[0, 10:] = 0.5
    for limits, law, name in (
        ({"amplitude": 5.0, "slew": 1e9}, gain(1.5), "amplitude"),
        ({"slew": 600.0}, gain(-1.3), "slew"),
        ({"reading": 4.0, "slew": 1e9}, gain(1.5), "reading"),
        ({"rms": (4.0, 1.0, 9.0), "rms_window_s": 0.01, "slew": 1e9}, gain(1.5), "rms"),
    ):
        lab = Lab()
        blocks, error = gathered(lab.bench(**limits).stream(u, None, law, block_samples=8))
        assert isinstance(error, InterlockError), error
        assert error.interlock == name
        assert f"interlock '{name}' ended the run at sample {error.sample}: 'push 1'" in str(error) or name in (
            "reading",
            "rms",
        )
        assert samples(blocks) == error.sample
        lab.assert_safe(limits["slew"])
        print(error)


def test_the_level_of_a_sensor_is_its_rms():
    lab = Lab()
    lab.answer = lambda k, u: [3.0 * np.sqrt(2) * np.sin(0.5 * k), 0.0, 0.0]
    lab.bench(rms=3.2, rms_window_s=0.1).run(np.zeros((2, 3000)))
    with pytest.raises(InterlockError, match=r"'speed 1' has 2\.8"):
        lab.bench(rms=2.8, rms_window_s=0.1).run(np.zeros((2, 3000)))


def test_late_frames_are_counted_and_in_the_end_not_tolerated(rng):
    late = iter([0, 1, 2, 0, 0, 3] + [0] * 94 + [0] * 1000)
    lab = Lab()
    record = lab.bench(wait=lambda: next(late)).run(np.zeros((2, 100)))
    assert record.provenance.settings["overruns"] == 6
    late = iter([0] * 30 + [1] * 1000)
    lab = Lab()
    blocks, error = gathered(lab.bench(wait=lambda: next(late), late_frames=4).stream(smooth(rng, 100)))
    assert isinstance(error, InterlockError)
    assert (error.interlock, error.sample, error.value) == ("late frames", 34, 5.0)
    assert sum(b.overruns for b in blocks) == 5
    lab.assert_safe()


def test_a_driver_that_hangs_is_not_trusted(rng):
    lab = Lab()
    sane = lab.answer
    lab.answer = lambda k, u: (time.sleep(0.35) if k == 20 else None) or sane(k, u)
    _, error = gathered(lab.bench(frame_s=0.3).stream(smooth(rng, 100)))
    assert isinstance(error, InterlockError)
    assert (error.interlock, error.sample) == ("frame", 21)
    lab.assert_safe()


def test_a_clock_that_is_slow_ends_the_run(rng):
    lab = Lab()
    wait = lambda: time.sleep(0.02)  # noqa: E731  twenty times slower than it should be
    _, error = gathered(lab.bench(wait=wait, duration_s=0.06, frame_s=0.3).stream(smooth(rng, 60)))
    assert isinstance(error, InterlockError)
    assert error.interlock == "duration"
    lab.assert_safe()


def test_a_broken_clock_does_not_keep_the_actuators_up(rng):
    lab, count = Lab(), iter(range(10**6))

    def wait():
        if next(count) >= 50:
            raise OSError("clock")

    blocks, error = gathered(lab.bench(wait=wait).stream(smooth(rng, 100)))
    assert "at sample 50 'wait' failed (OSError: clock)" in str(error)
    assert samples(blocks) == 50
    lab.assert_safe()


def test_actuators_that_cannot_be_reached_are_said_aloud(rng):
    lab = Lab()
    lab.fault = raising(OSError, 40, 10**6)
    _, error = gathered(lab.bench().stream(smooth(rng, 100)))
    assert isinstance(error, BenchError)
    assert "at sample 39 'write' failed" in str(error)
    assert "could not be brought to zero" in str(error)
    assert "switch them off by hand" in str(error)
    lab = Lab()
    lab.fault = Shy(OSError, 40, 5)  # a while only
    _, error = gathered(lab.bench().stream(smooth(rng, 100)))
    assert "at sample 39 'write' failed" in str(error)
    lab.assert_safe()


def test_one_run_at_a_time(rng):
    lab = Lab()
    bench = lab.bench()
    stream = bench.stream(smooth(rng, 100), block_samples=10)
    next(stream)
    with pytest.raises(BenchError, match="another run is going on"):
        bench.run(np.zeros((2, 5)))
    stream.close()
    lab.assert_safe()


def test_the_pacer_keeps_time_and_counts_what_it_misses():
    pacer, n = Pacer(500.0), 100
    began = time.perf_counter()
    missed = sum(pacer.wait() for _ in range(n))
    took = time.perf_counter() - began
    print(f"{n} frames at 500 Hz: {took * 1e3:.1f} ms, {missed} missed")
    assert took >= (n - 1) / 500.0
    time.sleep(0.011)
    assert pacer.wait() >= 5


DRIVER = """
import signal, sys, time
import numpy as np
from ultraquiet.bench import Hardware, Interlocks
from ultraquiet.values import Channel

out = open(sys.argv[1], "w", buffering=1)
for number in (signal.SIGHUP, signal.SIGQUIT):
    signal.signal(number, getattr(signal, sys.argv[3]))
bench = Hardware(
    lambda u: out.write(f"{float(u[0])!r}\\n"), lambda: [0.0], 1000.0, [Channel("push", "V", -10.0, 10.0)], ["speed"],
    Interlocks(slew_per_s=100.0, frame_s=30.0, late_frames=10**9), None,
)
u = 5.0 * np.sin(0.01 * np.arange(100_000))[None]
for block in bench.stream(u, block_samples=175):
    print(len(block.readings[0]), flush=True)
    time.sleep(float(sys.argv[2]))
"""


def driven(log, busy_s, handling):
    words = [sys.executable, "-c", DRIVER, str(log), str(busy_s), handling]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def written_to(log):
    return np.array([0.0, *(float(line) for line in log.read_text().splitlines())])


@pytest.mark.gate("0.0-1", "0.2-15")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGINT])
@pytest.mark.parametrize("busy_s", [0.0, 0.2])  # caught inside the loop, or while its blocks are being stored
def test_a_program_that_is_ended_from_outside_comes_down_softly(number, busy_s, tmp_path, rng):
    log = tmp_path / "written"
    with driven(log, busy_s, "SIG_DFL") as driver:
        driver.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.3))
        driver.send_signal(number)
        driver.stdout.read()
    sent = written_to(log)
    assert driver.returncode in (128 + number, -number)
    assert sent[-1] == 0.0
    assert len(sent) > 175
    jump = np.abs(np.diff(sent)).max()
    print(f"signal {number.name} after {len(sent)} writes: largest jump {jump:.4g} V of 0.1 V")
    assert 0.0 < jump <= 0.1 * (1 + 1e-9)


def test_what_is_ignored_stays_ignored(tmp_path):
    """As under `nohup`: the run goes on after its terminal is gone, and obeys `kill`."""
    log = tmp_path / "written"
    with driven(log, 0.0, "SIG_IGN") as driver:
        driver.stdout.readline()
        for number in (signal.SIGHUP, signal.SIGQUIT):
            driver.send_signal(number)
            time.sleep(0.2)
        before = len(written_to(log))
        for _ in range(3):
            assert driver.stdout.readline()
        driver.terminate()
        driver.stdout.read()
    sent = written_to(log)
    assert driver.returncode == 128 + signal.SIGTERM
    assert len(sent) > before
    assert sent[-1] == 0.0
    assert np.abs(np.diff(sent)).max() <= 0.1 * (1 + 1e-9)


def test_handlers_are_what_they_were_once_a_run_is_over(rng):
    ends = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    outside = [signal.signal(number, signal.SIG_DFL) for number in ends]
    try:
        stream = Lab().bench().stream(smooth(rng, 100), block_samples=10)
        next(stream)
        assert signal.SIG_DFL not in [signal.getsignal(number) for number in ends]
        stream.close()
        assert {signal.getsignal(number) for number in ends} == {signal.SIG_DFL}
    finally:
        for number, handler in zip(ends, outside, strict=True):
            signal.signal(number, handler)


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    amplitude=st.floats(0.01, 20.0),
    slew=st.floats(1.0, 1e5),
    share=st.floats(0.01, 1.2),
    closed=st.booleans(),
    disturbed=st.booleans(),
    stop_after=st.integers(0, 20),
)
def test_nothing_beyond_the_limits_is_ever_written(seed, amplitude, slew, share, closed, disturbed, stop_after):
    rng = np.random.default_rng(seed)
    n, kept = int(rng.integers(1, 120)), min(amplitude, AMPLITUDE)
    u = smooth(rng, n, share * (0.8 if disturbed else 1.0), slew, kept)
    d = smooth(rng, n, 0.2 * share, slew, kept) if disturbed else None
    lab = Lab()
    bench = lab.bench(slew=slew, amplitude=amplitude)
    asked = iter(range(10**6))
    law = gain(rng.normal()) if closed else None
    try:
        stream = bench.stream(u, d, law, block_samples=10, stop=lambda: next(asked) >= stop_after, ramp_samples=5)
    except InputError:
        assert share > 0.999  # nothing is refused that keeps to the limits
        assert lab.written == []
        return
    gathered(stream)
    lab.assert_safe(slew, kept)


def test_interlocks_answer_to_their_names_in_volts():
    older = Interlocks(amplitude_v=5.0, slew_v_per_s=(1e3,), reading_v=9.0, rms_v=2.0)
    assert older == Interlocks(amplitude=5.0, slew_per_s=(1e3,), reading=9.0, rms=2.0)
    assert (older.amplitude_v, older.slew_v_per_s, older.reading_v, older.rms_v) == (5.0, (1e3,), 9.0, 2.0)
    assert "_v" not in repr(older)
    with pytest.raises(InputError, match="'slew_v_per_s' is an older name of 'slew_per_s'; give one of them"):
        Interlocks(slew_v_per_s=1.0, slew_per_s=1.0)
