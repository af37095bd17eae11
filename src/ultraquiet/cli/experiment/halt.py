"""Ctrl-C that brings a bench to rest: asked for once or ten times, it ramps to zero and never jumps."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

from ultraquiet._base.errors import ENDINGS, interrupts

# These two are meant for this program by whoever sends them, even where a shell has it start with Ctrl-C ignored.
_MEANT = (signal.SIGINT, signal.SIGTERM)


class Halt:
    """Whether somebody wants the run to end; where a frame of a guarded bench hangs, the signal ends that itself."""

    only_notes: ClassVar[bool] = True  # to a guarded bench: see `Termination`

    def __init__(self) -> None:
        self._requested = False

    def requested(self) -> bool:
        """Return whether one of the signals has come."""
        return self._requested

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Note the wish; the same wish again changes nothing, so that the ramp under way is not cut short."""
        del number, frame
        self._requested = True


@contextmanager
def halting(ends_program: bool = False) -> Iterator[Halt]:
    """Turn SIGINT and the signals that end a program into a wish that the run asks for, block of samples by block.

    SIGHUP and SIGQUIT stay ignored where they are, as under `nohup`; afterwards every handler is what it was.

    Args:
        ends_program: whether the program ends once the wish has come. The same wish again must not end it with another
            exit code, before it has said where everything stands: what would do so is ignored from then on.
    """
    halt = Halt()
    if threading.current_thread() is not threading.main_thread():
        yield halt  # signals reach the main thread alone; whoever runs this elsewhere stops it otherwise
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDINGS)}
    before = {n: handler for n, handler in handlers.items() if n in _MEANT or handler is not signal.SIG_IGN}
    try:
        for number in before:
            signal.signal(number, halt.ask)
        yield halt
    finally:
        for number, handler in before.items():
            sudden = handler is signal.SIG_DFL or interrupts(handler)
            ending = ends_program and halt.requested()
            signal.signal(number, signal.SIG_IGN if sudden and ending else handler)
