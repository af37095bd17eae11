"""The errors a user meets. Each message is one sentence: who refuses, what it got, what it would take."""

import math
import signal
import time
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType


class UltraquietError(Exception):
    """Base of every error this package raises on purpose; the command line turns it into an exit code.

    Attributes:
        of_question: whether what was asked is refused, or failed with no law acting: it says nothing of any law.
    """

    of_question: bool = False


@contextmanager
def asking() -> Generator[None]:
    """Mark what is refused within a block as one of the question.

    >>> try:
    ...     with asking():
    ...         raise InputError("attenuation: too short.")
    ... except InputError as error:
    ...     error.of_question, InputError("Record: not finite.").of_question
    (True, False)
    """
    try:
        yield
    except UltraquietError as error:
        error.of_question = True
        raise


class InputError(UltraquietError, ValueError):
    """An argument has the wrong shape, unit, range or content."""


class RateError(InputError):
    """Two things that must share a sampling rate do not."""


class UnknownMethodError(UltraquietError, KeyError):
    """A name that no registered method carries."""

    def __str__(self) -> str:
        # KeyError quotes its argument, which would put a sentence between quotation marks.
        return str(self.args[0])


class StorageError(UltraquietError, OSError):
    """A file could not be read or written; nothing that was there before has been changed."""


class ToolError(UltraquietError, RuntimeError):
    """A program from outside, a compiler for instance, is missing or refused its work."""


class NumericalError(UltraquietError, ArithmeticError):
    """An equation has no acceptable solution; the message says which and why."""


class UnheardError(InputError, NumericalError):
    """Noise hides all that was to be measured; it says nothing of whether a loop is stable."""


class BenchError(UltraquietError, RuntimeError):
    """A bench from outside fell silent, died, answered nonsense or was stopped by an interlock while it ran."""


class RunawayError(InputError, BenchError):
    """What a bench read or a law commanded left the finite numbers: with each other, or either by itself."""


class StageError(UltraquietError, RuntimeError):
    """A stage of a study could not do its work; those before it are kept and reused."""


class InterlockError(BenchError):
    """An interlock has ended a run: which one, at which sample, on what value."""

    def __init__(self, sentence: str, interlock: str, sample: int, value: float) -> None:
        super().__init__(sentence)
        self.interlock, self.sample, self.value = interlock, sample, value

    @property
    def of_time(self) -> bool:
        """Whether it was the clock and not a level: frames that came too late, or a run that took too long."""
        return self.interlock in ("frame", "late frames", "duration")

    @property
    def of_level(self) -> bool:
        """Whether it was how much was sent or read, which a weaker run would not have been."""
        return self.interlock in ("amplitude", "slew", "reading", "rms")

    def __reduce__(self) -> tuple[type["InterlockError"], tuple[str, str, int, float]]:
        return InterlockError, (str(self), self.interlock, self.sample, self.value)


class SignalExit(SystemExit):
    """A signal has asked this program to end; the code is the shell's, 128 + number, and no file's own `sys.exit`."""


def of_the_loop(error: BaseException) -> bool:
    """Return whether a run ended by what the loop did: it left its levels or the finite numbers.

    A cable, a clock or an emergency stop says nothing of the law.
    """
    return isinstance(error, RunawayError) or (isinstance(error, InterlockError) and error.of_level)


def bench_failed(error: BaseException) -> bool:
    """Return whether a bench failed or was stopped by hand, whatever the loop did."""
    return isinstance(error, BenchError) and not of_the_loop(error)


def blames_no_law(error: UltraquietError) -> bool:
    """Return whether an error that ended a closed loop is one of the question or of the bench, and no verdict."""
    return error.of_question or bench_failed(error)


# Signals by which a shell, a terminal or a system ends a program, besides Ctrl-C. SIGKILL and a power cut reach no
# program: against them only a watch-dog in the hardware helps. Windows knows neither SIGHUP nor SIGQUIT.
ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))


class Interrupting:
    """A handler of signals that interrupts the program as Ctrl-C does; what comes again at once is the same wish.

    A supervisor may send a signal to a process and to its group, which it is in; the second must not cut short what the
    first began. After `AGAIN_S` it is a wish of its own, as Ctrl-C pressed again is.
    """

    AGAIN_S = 1.0

    def __init__(self) -> None:
        self._asked_s = -math.inf

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal.

        Raises:
            KeyboardInterrupt: it is the first, or comes later than at once.
        """
        del number, frame
        before, self._asked_s = self._asked_s, time.monotonic()
        if self._asked_s - before > self.AGAIN_S:
            raise KeyboardInterrupt


def interrupts(handler: object) -> bool:
    """Return whether a handler of signals is Ctrl-C's own, or does the same.

    >>> interrupts(signal.default_int_handler), interrupts(Interrupting()), interrupts(signal.SIG_DFL)
    (True, True, False)
    """
    return handler is signal.default_int_handler or isinstance(handler, Interrupting)


def signal_name(number: int) -> str:
    """Return how a signal that ended a program is called; those of real time have numbers alone.

    >>> signal_name(9), signal_name(40)
    ('SIGKILL', 'signal 40')
    """
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
