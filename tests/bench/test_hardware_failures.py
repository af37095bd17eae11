"""Sixty ways for callbacks to fail, lie or be interrupted: the card comes to zero within the slew limit in each."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ultraquiet._base.errors import ENDINGS, BenchError
from ultraquiet._base.threads import in_threads
from ultraquiet.bench import Blended, Block, Decimated, Hardware, Interlocks
from ultraquiet.bench.hardware.termination import DEPARTURE
from ultraquiet.cli.experiment.halt import halting
from ultraquiet.pipeline.stages import _ended_softly
from ultraquiet.values import Blending, Channel, Decimation

RATE_HZ, SLEW_V_PER_S, AT = 1000.0, 2000.0, 60
RAISED = (RuntimeError, MemoryError, RecursionError, KeyboardInterrupt, SystemExit, GeneratorExit)
# A write that fails may have reached the card or not; nobody can tell which.
PLACES = ("read", "write before the card", "write after the card", "wait", "controller", "stop")
LIES = {
    "read": (None, [1.0], [np.nan, 0, 0], [np.inf, 0, 0], "abc", object(), [1j, 0, 0], []),
    "wait": ("late", 10**12, np.nan, [1]),
    "controller": (np.array([np.nan, 0.0]), np.zeros(5), "u", None),
}
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGINT five times")
OTHERS = ("write changes what it is given", "the generator is closed", "the generator is forgotten")
CASES = [
    *(("raises", place, error) for place in PLACES for error in RAISED),
    *(("lies", place, answer) for place, answers in LIES.items() for answer in answers),
    *(("signal", "read", name) for name in SIGNALS),
    *(("other", what, None) for what in OTHERS),
]


class Card:
    """A card that goes wrong at one call."""

    def __init__(self, how, place, what):
        self.how, self.place, self.what = how, place, what
        self.held, self.calls = [np.zeros(2)], dict.fromkeys(("read", "write", "wait", "controller", "stop"), 0)

    def turn(self, name):
        """Count a call; at the one that goes wrong raise, or return the lie in a list."""
        self.calls[name] += 1
        if self.calls[name] != AT or self.place.split()[0] != name:
            return None
        if self.how == "raises":
            raise self.what("card")
        if self.how == "signal":
            for _ in range(5 if "five" in self.what else 1):
                os.kill(os.getpid(), getattr(signal, self.what.split()[0]))
        return [self.what] if self.how == "lies" else None

    def write(self, u):
        try:
            if self.place != "write after the card":
                self.turn("write")
            self.held.append(np.array(u))
            if self.place == "write after the card":
                self.turn("write")
        finally:
            if self.place == "write changes what it is given":
                u[:] = 99.0

    def answer(self, name, regular):
        lie = self.turn(name)
        return regular if lie is None else lie[0]

    # What a law and a bench ask for.
    rate_hz = RATE_HZ

    def reset(self):
        """Nothing to forget."""

    def step(self, y):
        del y
        return self.answer("controller", np.array([0.5, -0.5]))

    def bench(self):
        stop = lambda: bool(self.answer("stop", False))  # noqa: E731
        return Hardware(
            write=self.write,
            read=lambda: self.answer("read", [0.1, 0.2, 0.3]),
            rate_hz=RATE_HZ,
            actuators=[Channel("a", "V", -10, 10), Channel("b", "V", -10, 10)],
            sensors=["x", "y", "z"],
            interlocks=Interlocks(slew_per_s=SLEW_V_PER_S, ramp_s=0.05, stop=stop),
            wait=lambda: self.answer("wait", 0),
        )


def test_there_are_sixty():
    assert len(CASES) == 60


@pytest.mark.parametrize(("how", "place", "what"), CASES, ids=lambda value: getattr(value, "__name__", None))
def test_the_card_comes_to_zero_within_the_slew_limit(how, place, what):
    card = Card(how, place, what)
    bench = card.bench()
    u = np.minimum(np.arange(150) * 0.05, 5.0) * np.array([[1.0], [-0.8]])
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with contextlib.suppress(BaseException):
        if "generator" in place:
            stream = bench.stream(u, block_samples=50)
            next(stream)
            if "closed" in place:
                stream.close()
            del stream
        else:
            bench.run(u, controller=card)
    held = np.array(card.held)
    assert np.abs(held).max() > 1.0
    assert not held[-1].any()
    assert np.abs(np.diff(held, axis=0)).max() <= SLEW_V_PER_S / RATE_HZ * (1 + 1e-9)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert bench.run(np.zeros((2, 5))).samples == 5  # whatever failed once lets the next run begin


@pytest.mark.parametrize("reached", ["before", "after"])
def test_a_card_that_takes_nothing_any_more_is_named_to_whoever_stands_beside_it(reached):
    card = Card("none", "none", None)

    def write(u):
        card.held.append(np.array(u)) if reached == "after" or card.calls["write"] < AT else None
        card.calls["write"] += 1
        if card.calls["write"] >= AT:
            raise OSError("card")

    bench = card.bench()
    object.__setattr__(bench, "write", write)
    with pytest.raises(RuntimeError, match="switch them off by hand"):
        bench.run(np.minimum(np.arange(150) * 0.05, 5.0) * np.array([[1.0], [-0.8]]))


BLOCKS = ("for a block", "for a block of anybody's")
ENDED = [(how, number) for number in ENDINGS for how in ("for good", *BLOCKS)]
THREADED = [*ENDED, *((how, signal.SIGINT) for how in BLOCKS)]


@pytest.mark.gate(*(f"3-5-mm-{how}-{number:d}" for how, number in THREADED))
@pytest.mark.parametrize(("how", "number"), THREADED)
@pytest.mark.parametrize(("nu", "ny", "unit"), [(1, 1, "V"), (4, 3, "N"), (3, 5, "mm")])
def test_runs_in_threads_come_down_too_where_the_process_takes_signals(nu, ny, unit, how, number, monkeypatch):
    """Loops are closed in threads, which no signal reaches; asked again on the way down, it goes on."""
    monkeypatch.setattr(DEPARTURE, "_code", None)
    held = [np.zeros(nu)]

    def write(u):
        held.append(u.copy())
        if len(held) in (50, 55):
            os.kill(os.getpid(), number)

    actuators = [Channel(f"u{k}", unit, -5.0, 5.0) for k in range(nu)]
    interlocks = Interlocks(slew_per_s=100.0, frame_s=60.0)
    sensors = [f"y{k}" for k in range(ny)]
    # a card that keeps the time, however busy this machine is
    bench = Hardware(write, lambda: np.zeros(ny), RATE_HZ, actuators, sensors, interlocks, lambda: time.sleep(1e-3))
    rising = np.minimum(np.arange(5000) * 0.05, 2.0) * np.ones((nu, 1))
    # whoever started the tests may ignore some of them, as a shell does for what runs behind
    before = {each: signal.signal(each, signal.SIG_DFL) for each in ENDINGS}
    usual = dict.fromkeys(ENDINGS, signal.SIG_DFL) | {signal.SIGINT: signal.getsignal(signal.SIGINT)}
    known = bench if how == "for a block" else SimpleNamespace(run=bench.run)
    block = contextlib.nullcontext() if how == "for good" else _ended_softly(known)
    try:
        if how == "for good":
            DEPARTURE.takes_signals()
        with pytest.raises(KeyboardInterrupt if number == signal.SIGINT else SystemExit) as ended, block:
            in_threads("close", lambda _: bench.run(rising), ["bench"], 1)
        if how != "for good":
            assert {each: signal.getsignal(each) for each in usual} == usual
            assert bench.run(rising[:, :60]).samples == 60, "a process that goes on is free to run again"
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert number == signal.SIGINT or ended.value.code == 128 + number
    sent = np.array(held)
    assert sent.max() > 1.5
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 100.0 / RATE_HZ * (1 + 1e-9)
    assert len(sent) < 4000, "the run did not go on"
    assert DEPARTURE.way_down_s() == 0.0


def test_the_longest_way_down_is_known_while_a_run_is_up():
    """From the furthest value that may be sent, at the slew limit, or in the shortest ramp where that is longer."""
    known = []
    for slew, ramp_s in ((2.0, 0.1), (1e4, 0.3)):
        bench = Hardware(
            write=lambda u: known.append(round(DEPARTURE.way_down_s(), 6)),
            read=lambda: [0.0],
            rate_hz=RATE_HZ,
            actuators=[Channel("u", "V", -9.0, 5.0)],
            sensors=["y"],
            interlocks=Interlocks(amplitude=8.0, slew_per_s=slew, ramp_s=ramp_s),
        )
        bench.run(np.zeros((1, 3)))
    assert set(known) == {4.001, 0.3}
    assert DEPARTURE.way_down_s() == 0.0


def interrupting(*names, times):
    """Return a function for `sys.settrace` that presses Ctrl-C at each of the first lines of functions of a bench."""
    left = [times]

    def pressed(frame, event, _):
        if event == "line" and left[0]:
            left[0] -= 1
            os.kill(os.getpid(), signal.SIGINT)
        return pressed

    return lambda frame, *_: pressed if frame.f_code.co_name in names else None


def gone_through(stream: Any, closed: bool):
    for _ in stream:
        if closed:
            stream.close()


@pytest.mark.parametrize(("function", "times"), [("rest", 1), ("_descend", 10**6)])
@pytest.mark.parametrize(("nu", "ny", "unit", "scale"), [(1, 1, "V", 1.0), (4, 3, "N", 1e9), (3, 5, "m", 1e-9)])
@pytest.mark.parametrize("left", ["at its end", "closed", "by an error"])
def test_ctrl_c_at_any_line_of_the_way_down_leaves_no_actuator_up(nu, ny, unit, scale, left, function, times):
    held = []
    bench = Hardware(
        held.append,
        lambda: np.zeros(ny if left != "by an error" or len(held) != 30 else 0),
        RATE_HZ,
        [Channel(f"u{i}", unit, -scale, 10 * scale) for i in range(nu)],
        [f"y{i}" for i in range(ny)],
        Interlocks(slew_per_s=50.0 * scale, ramp_s=0.01),
        wait=lambda: None,
    )
    stream = bench.stream(np.minimum(np.arange(60) * 0.05, 2.0) * scale * np.ones((nu, 1)), block_samples=50)
    ended = BenchError if left == "by an error" else KeyboardInterrupt
    before = sys.gettrace(), signal.getsignal(signal.SIGINT)
    sys.settrace(interrupting(function, times=times))
    try:
        with pytest.raises((ended, KeyboardInterrupt)):
            gone_through(stream, left == "closed")
    finally:
        sys.settrace(before[0])
    sent = np.array(held)
    print(f"{len(sent)} samples sent, {np.abs(sent).max():.3g} at most, {np.abs(sent[-1]).max():.3g} last")
    assert np.abs(sent).max() > scale
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 0.05 * scale * (1 + 1e-9)
    assert signal.getsignal(signal.SIGINT) is before[1]
    assert bench.run(np.zeros((nu, 5))).samples == 5, "the next run is free to begin"


@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (4, 3), (3, 5)])
def test_a_clock_that_comes_back_no_more_is_given_up_by_the_second_ctrl_c(nu, ny):
    """The first ends the run; on the way down, too, the card is waited for until somebody asks once more."""
    held, dead = [np.zeros(nu)], threading.Event()

    def wait():
        if len(held) > 40:
            dead.set()
            time.sleep(60.0)

    def press():
        dead.wait()
        for _ in range(2):
            time.sleep(0.2)
            os.kill(os.getpid(), signal.SIGINT)

    bench = Hardware(
        held.append,
        lambda: np.zeros(ny),
        RATE_HZ,
        [Channel(f"u{i}", "V", -1.0, 10.0) for i in range(nu)],
        [f"y{i}" for i in range(ny)],
        Interlocks(slew_per_s=100.0, ramp_s=0.01, frame_s=0.02),
        wait,
    )
    hand = threading.Thread(target=press)
    hand.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            bench.run(np.minimum(np.arange(100) * 0.1, 2.0) * np.ones((nu, 1)))
    finally:
        hand.join()
    sent = np.array(held)
    assert sent.max() > 1.9
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 0.1 * (1 + 1e-9)


def in_modes(bench, nu, ny):
    m = min(nu, ny)
    modes = [f"m{i}" for i in range(m)]
    return Blended(bench, Blending(np.eye(ny)[:m], np.eye(nu)[:, :m], bench.sensors, bench.actuators, modes))


@pytest.mark.parametrize("around", [in_modes, lambda bench, *_: Decimated(bench, Decimation(4, averages=0))])
@pytest.mark.parametrize(("nu", "ny", "unit", "scale"), [(1, 1, "V", 1.0), (4, 3, "N", 1e9), (3, 5, "m", 1e-9)])
def test_a_bench_seen_through_another_is_at_rest_before_an_interrupt_of_that_is_told(
    around, nu, ny, unit, scale, monkeypatch
):
    """Whoever looks at the error holds its traceback, and with it what was under way."""
    held, blocks = [], []
    bench = Hardware(
        held.append,
        lambda: np.zeros(ny),
        RATE_HZ,
        [Channel(f"u{i}", unit, -scale, 10 * scale) for i in range(nu)],
        [f"y{i}" for i in range(ny)],
        Interlocks(slew_per_s=50.0 * scale, ramp_s=0.01),
        wait=lambda: None,
    )

    def block(*args, **how):
        blocks.append(None)
        if len(blocks) == 3:
            raise KeyboardInterrupt
        return Block(*args, **how)

    seen = around(bench, nu, ny)
    monkeypatch.setattr(f"{type(seen).__module__}.Block", block)
    monkeypatch.setattr(f"{type(seen).__module__}.replace", lambda before, **how: block(**how), raising=False)
    n = 2000
    with pytest.raises(KeyboardInterrupt) as interrupt:
        seen.run(np.minimum(np.arange(n) * 0.01, 2.0) * scale * np.ones((len(seen.actuators), 1)))
    sent = np.array(held)
    print(f"{len(sent)} samples sent, {np.abs(sent).max():.3g} at most, {np.abs(sent[-1]).max():.3g} last")
    assert interrupt.tb is not None
    assert len(sent) < n
    assert np.abs(sent).max() > 0.1 * scale
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 0.05 * scale * (1 + 1e-9)


def test_a_signal_ends_a_study_on_the_spot_where_no_guarded_bench_is_up():
    """Whatever is computed then may take long, and nothing needs to come to rest."""
    code = (
        "import signal; from ultraquiet.bench.hardware.termination import DEPARTURE\n"
        "with DEPARTURE.holding(guarded=False):\n"
        "    try: signal.raise_signal(signal.SIGINT)\n"
        "    except KeyboardInterrupt: print('once', flush=True)\n"
        "    try: signal.raise_signal(signal.SIGINT)\n"
        "    except KeyboardInterrupt: print('twice', flush=True)\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "    print('still there')\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout.split()) == (-signal.SIGTERM, ["once", "twice"])


def rising(held, nu, ny):
    """Return the stream of a bench on the way up, its first block measured."""
    channels = [Channel(f"u{i}", "V", -1.0, 10.0) for i in range(nu)], [f"y{i}" for i in range(ny)]
    locks = Interlocks(slew_per_s=100.0, ramp_s=0.01)
    bench = Hardware(held.append, lambda: np.zeros(ny), RATE_HZ, *channels, locks, lambda: None)
    stream: Any = bench.stream(np.minimum(np.arange(2000) * 0.05, 2.0) * np.ones((nu, 1)))
    next(stream)
    return stream


@pytest.mark.parametrize("order", ["in another thread", "the first first", "the last first"])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (4, 3), (3, 5)])
def test_however_runs_end_ctrl_c_is_heard_afterwards_and_handlers_are_what_they_were(nu, ny, order):
    before = [signal.getsignal(number) for number in (signal.SIGINT, *ENDINGS)]
    first, last = [], []
    streams = [rising(first, nu, ny)] + ([] if "thread" in order else [rising(last, nu, ny)])
    for stream in streams[:: -1 if order == "the last first" else 1]:
        if order == "in another thread":
            other = threading.Thread(target=stream.close)
            other.start()
            other.join()
        else:
            sys.settrace(interrupting("_descend", times=10**6))
            try:
                with pytest.raises(KeyboardInterrupt):
                    stream.close()
            finally:
                sys.settrace(None)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    rising([], nu, ny).close()
    assert [signal.getsignal(number) for number in (signal.SIGINT, *ENDINGS)] == before
    for held in (first, last):
        assert not held or (np.max(held) > 1.0 and not held[-1].any())


@pytest.mark.parametrize("hangs", ["wait", "read"])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (4, 3), (3, 5)])
def test_a_frame_that_hangs_is_ended_by_ctrl_c_where_a_list_runs(nu, ny, hangs):
    """A list asks for it between blocks of samples, of which there are no more."""
    held, dead = [np.zeros(nu)], threading.Event()

    def hanging(answer):
        if np.max(held[-1]) > 1.9 and not dead.is_set():
            dead.set()
            time.sleep(60.0)
        return answer

    bench = Hardware(
        held.append,
        lambda: hanging(np.zeros(ny)) if hangs == "read" else np.zeros(ny),
        RATE_HZ,
        [Channel(f"u{i}", "V", -1.0, 10.0) for i in range(nu)],
        [f"y{i}" for i in range(ny)],
        Interlocks(slew_per_s=100.0, ramp_s=0.01, frame_s=0.1),
        lambda: hanging(0) if hangs == "wait" else 0,
    )

    def press():
        dead.wait()
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    hand = threading.Thread(target=press)
    before = signal.getsignal(signal.SIGINT)
    with halting() as halt:
        hand.start()
        with pytest.raises(KeyboardInterrupt):
            list(bench.stream(np.minimum(np.arange(900) * 0.05, 2.0) * np.ones((nu, 1)), stop=halt.requested))
        hand.join()
        assert halt.requested()
    assert signal.getsignal(signal.SIGINT) is before
    sent = np.array(held)
    assert sent.max() > 1.9
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 0.1 * (1 + 1e-9)


@pytest.mark.parametrize(("nu", "ny", "end"), [(1, 1, "raise ValueError"), (4, 3, "sys.exit(1)"), (3, 5, "break")])
def test_a_program_that_ends_with_an_iterator_in_its_hand_has_led_the_bench_to_zero(tmp_path, nu, ny, end):
    """A driver opens files and imports what it needs, which is there no more once Python takes itself apart."""
    script = f"""
import sys
import numpy as np
from ultraquiet.bench import Hardware, Interlocks
from ultraquiet.values import Channel

def write(u):
    import json
    with open({str(tmp_path / "sent")!r}, "a") as sent:
        print(json.dumps(u.tolist()), file=sent)

channels = [Channel(f"u{{i}}", "V", -1.0, 10.0) for i in range({nu})], [f"y{{i}}" for i in range({ny})]
bench = Hardware(write, lambda: np.zeros({ny}), 1000.0, *channels, Interlocks(slew_per_s=100.0), lambda: None)
stream = bench.stream(np.minimum(np.arange(900) * 0.05, 2.0) * np.ones(({nu}, 1)))
for block in stream:
    {end}
"""
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    sent = np.array([json.loads(line) for line in (tmp_path / "sent").read_text().splitlines()])
    print(ended.stderr[-300:], f"{len(sent)} samples sent, {np.abs(sent[-1]).max():.3g} last")
    assert ended.returncode == (end != "break")
    assert sent.max() > 1.5
    assert not sent[-1].any()
    assert np.abs(np.diff(sent, axis=0)).max() <= 0.1 * (1 + 1e-9)
    assert "could not be brought to zero" not in ended.stderr
