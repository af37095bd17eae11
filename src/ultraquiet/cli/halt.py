"""Ctrl-C that brings a bench to rest: asked for once or ten times, it ramps to zero and never jumps."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Ctrl-C, the polite end from outside, and the terminal that was closed (which Windows does not know).
_WISHES = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Halt:
    """Whether somebody wants the run to end."""

    def __init__(self) -> None:
        self._asked = False

    def asked(self) -> bool:
        """Return whether one of the signals has come."""
        return self._asked

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Note the wish; the same wish again changes nothing, so that the ramp under way is not cut short."""
        del number, frame
        self._asked = True


@contextmanager
def halting() -> Iterator[Halt]:
    """Turn SIGINT, SIGTERM and SIGHUP inside the block into a wish that the run asks for, block of samples by block."""
    halt = Halt()
    if threading.current_thread() is not threading.main_thread():
        yield halt  # signals reach the main thread alone; whoever runs this elsewhere stops it otherwise
        return
    before = {number: signal.signal(number, halt.ask) for number in _WISHES}
    try:
        yield halt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
