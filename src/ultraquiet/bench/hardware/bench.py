"""Somebody's real bench: two callbacks between interlocks."""

import atexit
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import BenchError, InputError, UltraquietError, asking
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.one_line import described, one_line
from ultraquiet.bench.hardware.interlocks import Guard, Interlocks
from ultraquiet.bench.hardware.pacing import Pacer
from ultraquiet.bench.hardware.termination import Stalled, Termination
from ultraquiet.bench.stepped import Loop, Setup, Stepped, SteppedPlant
from ultraquiet.values import Channel
from ultraquiet.values.channel import channels

PATIENCE = 20  # how often a write that fails is tried again on the way to zero


@dataclass(frozen=True, init=False)
class Hardware(Stepped):
    """A bench of hardware, driven by `write` and `read` once a frame.

    At frame k it waits for its time, writes the command formed in the frame before plus the disturbance of this one,
    and reads. What is known to trip an interlock is refused before anything moves. However a run ends (its end, a
    stop, an interlock, an error, Ctrl-C, SIGTERM, SIGHUP, SIGQUIT, an iterator that is closed), the actuators are led
    from the last value written to zero within the slew limit, and zeros are written at the very end. See
    docs/hardware.md.

    A stop through `stream(stop=...)` takes the same way down with the controller off, and records it; differs from
    other benches, which fade the controller's command: a straight line is the one way that keeps any slew limit.

    It is not registered, since a list cannot hold callbacks: hand it over, `uq.experiments.run(listed, folder, bench)`.

    Args:
        write: takes `(nu,)` commands in the actuators' units, puts them out at once.
        read: returns the readings `(ny,)`, in the sensors' units.
        rate_hz: frames per second.
        actuators, sensors: channels or names; actuators need finite limits here or in `interlocks`.
        interlocks: what ends a run; see `Interlocks`.
        wait: returns when the next frame begins, and how many have been missed (None: none); by default this machine's
            clock (`time.perf_counter`).

    Raises:
        InputError: actuators without limits, a signal that is known to trip an interlock.
        InterlockError: an interlock tripped; it names which, the sample and the value.
        BenchError: `write`, `read` or `wait` failed or returned nonsense.

    >>> volts = [0.0]
    >>> bench = Hardware(
    ...     write=lambda u: volts.append(float(u[0])),
    ...     read=lambda: [volts[-1]],
    ...     rate_hz=1000.0,
    ...     actuators=[Channel("push", "V", -10.0, 10.0)],
    ...     sensors=["speed"],
    ...     interlocks=Interlocks(slew_per_s=2000.0, ramp_s=0.002),
    ... )
    >>> bench.run([[1.0, 2.0, 3.0]]).outputs.tolist(), volts[-3:]
    ([[0.0, 1.0, 2.0]], [1.0, 0.0, 0.0])
    """

    write: Callable[[FloatArray], Any]
    read: Callable[[], ArrayLike]
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    interlocks: Interlocks
    wait: Callable[[], int | None] | None
    _running: threading.Lock = field(repr=False, compare=False)

    def __init__(
        self,
        write: Callable[[FloatArray], Any],
        read: Callable[[], ArrayLike],
        rate_hz: float,
        actuators: Sequence[Channel | str],
        sensors: Sequence[Channel | str],
        interlocks: Interlocks | None = None,
        wait: Callable[[], int | None] | None = None,
    ) -> None:
        for name, callback in (("write", write), ("read", read), ("wait", wait)):
            if not callable(callback) and not (name == "wait" and callback is None):
                raise InputError(f"Hardware: '{name}' must be a function, got {type(callback).__name__}.")
        put = object.__setattr__
        put(self, "write", write)
        put(self, "read", read)
        put(self, "wait", wait)
        put(self, "rate_hz", positive("Hardware", "rate_hz", rate_hz, "Hz"))
        put(self, "actuators", channels("Hardware", actuators, len(actuators), "input"))
        put(self, "sensors", channels("Hardware", sensors, len(sensors), "output"))
        put(self, "interlocks", interlocks or Interlocks())
        put(self, "_running", threading.Lock())
        self._guard()  # refuses limits that do not fit the channels

    @property
    def provenance(self) -> Provenance:
        """Who measures, and between which limits."""
        limits = {name: value for name, value in vars(self.interlocks).items() if name != "stop"}
        return Provenance("bench.hardware", {"rate_hz": self.rate_hz, "interlocks": limits})

    def _guard(self) -> Guard:
        return Guard(self.interlocks, self.rate_hz, self.actuators, self.sensors)

    def _setup(self) -> Setup:
        return Setup("Hardware.run", _Rig(self, self._guard()), self.rate_hz, self.actuators, self.sensors)

    def _loop(self, setup: Setup, actuation: ArrayLike, disturbance: ArrayLike | None, controller: Any | None) -> Loop:
        loop = _Descending.of(setup, actuation, disturbance, controller)
        guard = self._guard()
        formed = np.clip(loop.u, loop.low[:, None], loop.high[:, None])
        with asking():
            guard.foresee(np.concatenate([np.zeros((len(formed), 1)), formed[:, :-1]], axis=1) + loop.d)
        return loop


class _Descending(Loop):
    """A run that is stopped by a straight line to zero, from what is sent at that moment."""

    def fade(self, ramp_samples: int) -> None:
        rig = self.setup.plant
        assert isinstance(rig, _Rig)
        sent = self.held_command + self.d[:, self.k]
        samples = rig.guard.ramp_samples(sent, ramp_samples)
        self.end = min(self.end, self.k + samples)
        fading = 1.0 - np.arange(1, self.end - self.k + 1) / samples
        self.u[:, self.k : self.end] = sent[:, None] * fading
        self.d[:, self.k + 1 :] = 0.0
        self.law, self.faded = None, True


class _Rig(SteppedPlant):
    """The callbacks during one run."""

    def __init__(self, bench: Hardware, guard: Guard) -> None:
        self._bench, self.guard = bench, guard
        self._wait = bench.wait or Pacer(bench.rate_hz).wait
        self._last = np.zeros(len(bench.actuators))
        self._late, self._mine, self._doubtful = 0, False, False
        self._began = self._before = self._wrote_s = 0.0
        self._termination = Termination()

    def start(self, run_index: int) -> None:
        if not self._bench._running.acquire(blocking=False):
            raise BenchError("Hardware: another run is going on; finish or close that one first.")
        self._mine = True
        self._termination.hold(self._longest_s())
        if threading.current_thread() is threading.main_thread():
            atexit.register(self._forgotten)  # the last time at which what a card's driver needs is there
        self._began = self._before = time.perf_counter()
        self._termination.frame(self._began + self.guard.frame_s)
        self._write(self._last, 0)

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        self._termination.check()
        self._frame(k)
        value = u + d
        self.guard.out(value, self._last, k)
        self._write(value, k)
        y = self._read(k)
        self.guard.back(y, k)
        return y

    def overruns(self) -> int:
        late, self._late = self._late, 0
        return late

    def rest(self, error: BaseException | None) -> None:
        if not self._mine:
            return
        self._termination.descends()
        try:
            interrupt, failure = self._descend()
        finally:
            self._mine = False
            atexit.unregister(self._forgotten)
            self._termination.release()
            self._bench._running.release()
        if failure is not None:
            ours = isinstance(error, UltraquietError)
            what = "" if error is None else f"{(str(error) if ours else described(error)).rstrip('.')}; and "
            raise BenchError(
                f"{what}Hardware: the actuators could not be brought to zero, 'write' failed {PATIENCE} times "
                f"({described(failure)}); they may still hold {np.round(self._last, 6).tolist()}, switch them off by "
                "hand."
            ) from error
        ending = interrupt or self._termination.ending
        if ending is not None and error is None:
            raise ending

    def _forgotten(self) -> None:
        """Come to rest at the end of a program that holds an iterator still, in an error's traceback for instance."""
        self.rest(None)

    def _descend(self) -> tuple[BaseException | None, Exception | None]:
        """Lead the actuators to zero, whatever happens meanwhile; return an interrupt and a failure that stayed."""
        bench = self._bench
        samples = self._ramp_samples(self._last)
        # What a filter has left below the smallest normal number has no parts.
        step = np.maximum(np.abs(self._last) / samples, np.finfo(np.float64).tiny)
        interrupt: BaseException | None = None
        failures: list[Exception] = []
        done = False
        while not done and len(failures) < PATIENCE:
            try:
                done = not self._last.any()  # zeros are written once more at the end
                self._idle()
                nearer = self._last - np.copysign(np.minimum(step, np.abs(self._last)), self._last)
                if self._doubtful:  # a write that failed may have come through: from there, too, one step back at most
                    nearer, done = self._last, False
                self._wrote_s = time.perf_counter()
                bench.write(nearer.copy())
                self._last, self._doubtful = nearer, False
            except Exception as error:
                failures.append(error)
                done = False
            except BaseException as error:  # of somebody's own handler of signals: it keeps no actuator where it is
                interrupt, done = error, False
        return interrupt, None if done else failures[-1]

    def _ramp_samples(self, value: FloatArray) -> int:
        least = int(np.ceil(self._bench.interlocks.ramp_s * self._bench.rate_hz))
        return self.guard.ramp_samples(value, least)

    def _longest_s(self) -> float:
        """Return how long the way down takes from the furthest value that may be sent."""
        return self._ramp_samples(np.maximum(-self.guard.low, self.guard.high)) / self._bench.rate_hz

    def _idle(self) -> None:
        try:
            with self._termination.waiting(self.guard.frame_s):
                self._waited()
        except (Exception, Stalled):
            self._pace_down()
            self._wait()

    def _waited(self) -> int:
        """Return how many frames have been missed, as who paces the run says."""
        answer = self._wait()
        if answer is None:
            return 0
        late = int(answer)
        if late != answer or late < 0:
            raise ValueError(f"frames that were missed are a whole number from 0, got {one_line(answer)}")
        return late

    def _pace_down(self) -> None:
        """Whatever paced the run is broken: this machine's clock leads the way down, from the last write on."""
        self._wait = Pacer(self._bench.rate_hz, self._wrote_s).wait

    def _frame(self, k: int) -> None:
        try:
            late = self._waited()
        except Exception as error:
            self._pace_down()
            raise BenchError(f"Hardware: at sample {k} 'wait' failed ({described(error)}).") from error
        now = time.perf_counter()
        self._late += late
        elapsed_s, self._before = now - self._before, now
        self._termination.frame(now + self.guard.frame_s)
        self.guard.frame(late, elapsed_s, now - self._began, k)

    def _write(self, value: FloatArray, k: int) -> None:
        self._doubtful, self._wrote_s = True, time.perf_counter()
        try:
            self._bench.write(value.copy())
        except Exception as error:
            raise BenchError(f"Hardware: at sample {k} 'write' failed ({described(error)}).") from error
        self._last, self._doubtful = value.copy(), False

    def _read(self, k: int) -> FloatArray:
        try:
            answer = self._bench.read()
            y = _numbers(answer)
        except Exception as error:
            raise BenchError(f"Hardware: at sample {k} 'read' failed ({described(error)}).") from error
        expected = len(self._bench.sensors)
        if y.size != expected or not np.isfinite(y).all():
            raise BenchError(
                f"Hardware: at sample {k} 'read' must return {expected} finite numbers, got {one_line(answer)}."
            )
        return y


def _numbers(answer: ArrayLike) -> FloatArray:
    """Return readings; what is no real number, or is masked, is none."""
    y = np.asanyarray(answer)
    if y.dtype.kind not in "buifO":
        raise TypeError(f"readings are real numbers, got {y.dtype}")
    if np.ma.getmaskarray(y).any():
        raise ValueError("a reading is masked")
    return np.array(y, dtype=np.float64).reshape(-1)
