"""Callbacks of hardware that answer nonsense: no step faster than the slew limit, and a sentence on one line."""

import time

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import BenchError, InterlockError
from ultraquiet.bench import Interlocks

RATE_HZ, SLEW = 100.0, 100.0


class UnsayableError(Exception):
    """An error whose words cannot be had."""

    def __str__(self):
        raise ValueError("no words")


def raising(error):
    raise error


def driven(wait=None, read=lambda: [0.0], write=None, stop=None):
    """Return what was written, (time, value), and the error that ended a run up to 8 N."""
    written = []

    def noted(u):
        written.append((time.perf_counter(), float(u[0])))
        if write is not None:
            write(u)

    bench = uq.bench.Hardware(
        write=noted,
        read=read,
        rate_hz=RATE_HZ,
        actuators=[uq.Channel("push", "N", -10, 10)],
        sensors=["speed"],
        interlocks=Interlocks(slew_per_s=SLEW, ramp_s=0.01, amplitude=10.0, stop=stop),
        wait=wait,
    )
    u = np.minimum(0.99 * SLEW / RATE_HZ * np.arange(20), 8.0)[None]
    with pytest.raises((BenchError, InterlockError)) as told:
        bench.run(u)
    assert len(str(told.value).splitlines()) == 1
    return np.array(written), str(told.value)


def paced(then):
    """Return a `wait` that is right for ten frames."""
    count = []

    def wait():
        count.append(1)
        if len(count) > 10:
            return then()
        time.sleep(1 / RATE_HZ)
        return 0

    return wait


@pytest.mark.parametrize(
    "answer",
    [float("nan"), -1, "3", np.array([0, 1]), 1.5, object(), OSError("gone"), UnsayableError()],
    ids=lambda answer: type(answer).__name__,
)
def test_a_wait_that_answers_nonsense_leads_to_zero_no_faster_than_the_slew_limit(answer):
    written, told = driven(paced(lambda: raising(answer) if isinstance(answer, Exception) else answer))
    assert "'wait' failed" in told
    assert written[-1, 1] == 0.0
    assert written[:, 1].max() > 5.0
    fast = [
        abs(b[1] - a[1]) for k, a in enumerate(written) for b in written[k + 1 : k + 8] if b[0] - a[0] < 0.5 / RATE_HZ
    ]
    print(f"largest change within half a frame {max(fast, default=0.0):.3g} N, {SLEW / RATE_HZ:g} allowed in a frame")
    assert max(fast, default=0.0) <= SLEW / RATE_HZ * (1 + 1e-9)


def test_actuators_that_hold_are_told_whatever_the_error_says_of_itself():
    def broken(u):
        if u[0] > 5.0 or calls:
            calls.append(1)
            raise UnsayableError

    calls: list[int] = []
    _, told = driven(write=broken)
    assert "may still hold [" in told
    assert "UnsayableError" in told


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        ([1 + 2j], "complex"),
        (np.ma.array([7.0], mask=[True]), "masked"),
        (np.array(["2020-01-01"], dtype="datetime64[s]"), "datetime64"),
        (["1.5"], "real numbers"),
        (None, "finite numbers"),
        (np.zeros(90), "finite numbers"),
        ([float("nan")], "finite numbers"),
    ],
)
def test_what_is_no_reading_is_refused(answer, word):
    _, told = driven(read=lambda: answer)
    assert word in told
    assert len(told) < 500


def test_a_stop_that_fails_counts_as_pressed():
    _, told = driven(stop=lambda: raising(RuntimeError("button\ngone")))
    assert "does not tell whether it was pressed (RuntimeError: button gone)" in told


def test_a_huge_reading_trips_no_limit_that_nobody_set():
    push, timeless = uq.Channel("push", "N", -1, 1), uq.bench.Interlocks(frame_s=600.0)  # however busy the machine is
    bench = uq.bench.Hardware(lambda u: None, lambda: [1e200], 1e3, [push], ["speed"], timeless, wait=lambda: 0)
    assert bench.run(np.zeros((1, 5))).outputs[0].tolist() == [1e200] * 5


@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (4, 3), (3, 5)])
@pytest.mark.parametrize("value", [5e-324, 1e-322, -3e-310, 1e-300])
def test_what_is_left_of_a_command_that_has_died_away_comes_to_zero_in_time(nu, ny, value):
    """A filter stays for ever at the last numbers above zero, which have no tenth of themselves."""
    sent = []

    def write(u):
        if len(sent) > 100:
            raise RuntimeError("too many")
        sent.append(u)

    actuators = [uq.Channel(f"u{i}", "N", -1, 10) for i in range(nu)]
    locks = Interlocks(slew_per_s=SLEW, ramp_s=0.1)
    sensors = [f"y{i}" for i in range(ny)]
    bench = uq.bench.Hardware(write, lambda: np.zeros(ny), RATE_HZ, actuators, sensors, locks, lambda: 0)
    assert bench.run(np.full((nu, 20), value)).samples == 20
    print(f"{len(sent)} samples sent")
    assert not sent[-1].any()
    assert all(np.all(np.abs(u) <= abs(value)) for u in sent)
