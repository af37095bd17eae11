"""Work in threads of which nobody hears any more ends where it next asks."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from ultraquiet._base.progress import task
from ultraquiet._base.threads import in_threads
from ultraquiet.bench import Hexapod, Wrapped
from ultraquiet.values import StateSpace

PATIENCE_S = 30.0  # of a test that would go on for minutes
RATE_HZ = 1000.0


def interrupted(work):
    """Do `work(begun)`, in a thread of a thread, and press Ctrl-C once it has begun; return when it began and ended."""
    times = []

    def begun():
        if not times:
            times.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)

    def noted(_):
        try:
            work(begun)
        finally:
            times.append(time.monotonic())

    with pytest.raises(KeyboardInterrupt):
        in_threads("outer", lambda _: in_threads("inner", noted, ["b"], 1), ["a"], 1)
    print(f"ended {times[1] - times[0]:.2f} s after Ctrl-C")
    return times[1] - times[0]


def steps(begun):
    with task("steps", 10**6) as progress:
        for _ in range(int(PATIENCE_S / 1e-3)):
            begun()
            time.sleep(1e-3)
            progress.advance()


def samples_in_python(begun):
    def step(u, d):
        begun()
        time.sleep(1e-3)
        return np.zeros(3)

    bench = Wrapped(step, lambda: None, RATE_HZ, ["a", "b"], ["p", "q", "r"])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), -0.1 * np.ones((2, 3)), RATE_HZ)
    bench.run(np.zeros((2, int(PATIENCE_S * RATE_HZ))), controller=law)


def samples_of_machine_code(begun):
    bench = Hexapod(unit="ground", seed=1)
    for block in bench.stream(np.zeros((6, 210_000)), block_samples=350):
        begun()
        time.sleep(0.05)
        assert block.readings.shape[1] == 350


@pytest.mark.parametrize("work", [steps, samples_in_python, samples_of_machine_code])
def test_ctrl_c_ends_what_goes_on_in_threads(work):
    assert interrupted(work) < PATIENCE_S / 3


def test_who_interrupts_itself_ends_nothing_else():
    """Each block of threads ends what it waits for, and nothing after that."""
    interrupted(steps)
    assert in_threads("again", lambda item: item + 1, [1, 2], 2) == {1: 2, 2: 3}


def press():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("when", ["others are being begun", "the rest is waited for after an error"])
def test_ctrl_c_at_any_time_ends_what_goes_on_in_threads(when, monkeypatch):
    """Whoever has begun ends, and whoever has not does not begin."""
    begun, ended, out = threading.Event(), [], []
    submit = ThreadPoolExecutor.submit

    def submitted(pool, *args):
        if out:
            begun.wait()
            press()
        out.append(args)
        return submit(pool, *args)

    def work(item):
        if item == "fails":
            begun.wait()
            threading.Timer(0.2, press).start()
            raise ValueError("of one")
        try:
            steps(begun.set)
        finally:
            ended.append(item)

    items = ["a", "b"]
    if when == "others are being begun":
        monkeypatch.setattr(ThreadPoolExecutor, "submit", submitted)
    else:
        items = ["a", "fails"]
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        in_threads("any time", work, items, 2)
    print(f"ended after {time.monotonic() - start:.2f} s: {ended}")
    assert ended == ["a"]
    assert time.monotonic() - start < PATIENCE_S / 3


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("workers", [1, 2])
def test_what_waits_for_a_thread_does_not_begin_after_an_error(error, workers):
    begun = []

    def work(item):
        begun.append(item)
        time.sleep(0.05)
        if item == 1:
            raise error

    with pytest.raises(error):
        in_threads("one after another", work, list(range(10)), workers)
    assert len(begun) <= 2 + 2 * workers
