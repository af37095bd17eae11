"""Being ended from outside, by `kill` or a closed terminal: an exception, as Ctrl-C is, while something is up."""

import math
import signal
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from ultraquiet._base.errors import ENDINGS, SignalExit, interrupts

FATAL = 128  # the shell's exit code of a program that a signal ended is this much more


class Departure:
    """The end of this process from outside, of which its runs learn in whichever threads they are."""

    def __init__(self) -> None:
        self._code: int | None = None
        self._up: dict[int, float] = {}

    def begins(self, run: object, way_down_s: float) -> None:
        """Note a run that is up, and the longest time that its actuators need to zero."""
        self._up[id(run)] = way_down_s

    def ends(self, run: object) -> None:
        """Note that a run is over."""
        self._up.pop(id(run), None)

    def way_down_s(self) -> float:
        """Return the longest time that runs which are up need to bring their actuators to zero, 0 without any."""
        return max(list(self._up.values()), default=0.0)

    def takes_signals(self) -> None:
        """From here on a signal that would end this process ends its runs at their next samples, then the process.

        What is ignored stays ignored. Called in the main thread.
        """
        for number in ENDINGS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._leave)

    @contextmanager
    def holding(self, guarded: bool = True) -> Generator[None]:
        """Take signals that would end the process on the spot for the length of a block whose runs are in threads.

        Ctrl-C, and what does the same, interrupts the block once: asked for again, the way down goes on. Handlers that
        somebody else has installed stay in charge; outside the main thread nothing can be done. Where nobody knows
        whether a bench is `guarded`, one of somebody's own around a guarded one, signals are taken while a guarded run
        is up.
        """
        mine = threading.current_thread() is threading.main_thread()
        leave, interrupt = (self._leave, self._interrupt) if guarded else (self._leave_if_up, self._interrupt_if_up)
        found = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDINGS) if mine}
        before = {n: handler for n, handler in found.items() if handler is signal.SIG_DFL or interrupts(handler)}
        try:
            for number, handler in before.items():
                signal.signal(number, interrupt if interrupts(handler) else leave)
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            if before:
                self._code = None  # whoever goes on after this is free to run again

    def handles(self, handler: object) -> bool:
        """Tell whether a handler of signals is one of these."""
        return handler in (self._leave, self._interrupt, self._leave_if_up, self._interrupt_if_up)

    def check(self) -> None:
        """End the run that asks, where the process is ending."""
        if self._code is not None:
            raise SignalExit(self._code)

    def _leave(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._code is None:  # a second signal must not cut short what the first began
            self._code = FATAL + number
            raise SignalExit(self._code)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._code is None:
            self._code = FATAL + number
            raise KeyboardInterrupt

    def _leave_if_up(self, number: int, frame: FrameType | None) -> None:
        if self._up:
            self._leave(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    def _interrupt_if_up(self, number: int, frame: FrameType | None) -> None:
        (self._interrupt if self._up else signal.default_int_handler)(number, frame)


DEPARTURE = Departure()


# An interrupt, which no `except Exception` of a card's driver takes for an answer.
class Stalled(KeyboardInterrupt):
    """Whoever keeps the time has not come back for long, and somebody has asked again for the end."""


class Termination:
    """Turns signals that would end Python on the spot into SystemExit, between `hold` and `release`.

    From `descends` on they are put off, Ctrl-C too, so that nothing cuts the way down short: `ending` is the exception
    that the first of them would have been. Handlers that somebody else has installed stay in charge, and what is
    ignored stays ignored (SIGHUP under `nohup`); outside the main thread nothing can be done but to `check` whether
    `DEPARTURE` has taken one. Who has an attribute `only_notes` notes a wish that is asked for block by block; of a
    frame that hangs nobody asks.
    """

    def __init__(self) -> None:
        self._before: dict[signal.Signals, Any] = {}
        self._down, self._over, self._late_s = False, False, math.inf
        self.ending: BaseException | None = None

    def hold(self, way_down_s: float) -> None:
        """From here on an end from outside is an exception; `way_down_s` is how long the actuators need to zero."""
        DEPARTURE.begins(self, way_down_s)
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, *ENDINGS):
                handler = _standing(number, signal.getsignal(number))
                whose = getattr(handler, "__self__", None)
                ours = DEPARTURE.handles(handler) or isinstance(whose, Termination) or hasattr(whose, "only_notes")
                if ours or handler is signal.SIG_DFL or interrupts(handler):
                    self._before[number] = handler  # before it is replaced: it may be asked for at once
                    signal.signal(number, self._take)

    def check(self) -> None:
        """Raise SystemExit where this process is being ended, in whichever thread."""
        DEPARTURE.check()

    def descends(self) -> None:
        """From here on the actuators are led to zero, and an end from outside waits for that."""
        self._down, self._late_s = True, math.inf

    def frame(self, late_s: float) -> None:
        """Begin a frame: a signal after `late_s` of this machine's clock raises `Stalled`, whoever only notes it."""
        self._late_s = late_s

    @contextmanager
    def waiting(self, longest_s: float) -> Generator[None]:
        """Let a signal end a wait on the way down that takes longer than so many seconds.

        Raises:
            Stalled: one came after that time.
        """
        self._late_s = time.perf_counter() + longest_s
        try:
            yield
        finally:
            self._late_s = math.inf

    def release(self) -> None:
        """From here on it is sudden again.

        Runs may end in another order than they began, or in another thread, where no handler can be put back: one that
        is left passes signals on to the one before, and the next run does without it.
        """
        DEPARTURE.ends(self)
        self._down, self._over, self._late_s = False, True, math.inf
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._take:
                    signal.signal(number, _standing(number, handler))

    def before(self, number: signal.Signals) -> Any:
        """Return who takes a signal after the run; None while it is up."""
        return self._before[number] if self._over else None

    def _take(self, number: int, frame: FrameType | None) -> None:
        try:
            self._act(number, frame)  # `DEPARTURE` tells the runs in other threads
        except (KeyboardInterrupt, SystemExit) as ending:
            if not self._down:
                raise
            self.ending = self.ending or ending
        if time.perf_counter() > self._late_s:
            raise Stalled

    def _act(self, number: int, frame: FrameType | None) -> None:
        handler = self._before.get(signal.Signals(number), signal.SIG_DFL)
        if callable(handler):
            handler(number, frame)
        else:
            raise SignalExit(FATAL + number)


def _standing(number: signal.Signals, handler: Any) -> Any:
    """Return a handler, or the one before it where that is left of a run that is over."""
    while isinstance(run := getattr(handler, "__self__", None), Termination):
        before = run.before(number)
        if before is None:
            break
        handler = before
    return handler
