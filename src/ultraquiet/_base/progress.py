"""Progress of long work, told to whoever listens, and whether anybody waits for it any more.

Computation never prints; the command line listens with bars.
"""

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event
from typing import Protocol


class Listener(Protocol):
    """What a display must offer."""

    def start(self, title: str, total: int) -> int:
        """Begin a task of `total` steps and return its key."""
        ...

    def advance(self, key: int, steps: int, note: str) -> None:
        """Move a task forward; `note` says what is in hand."""
        ...

    def finish(self, key: int) -> None:
        """End a task."""
        ...


_listener: ContextVar[Listener | None] = ContextVar("ultraquiet_progress", default=None)
# Set where whoever waits for this work was interrupted, of all who do: threads hear of no interrupt by themselves.
_interrupts: ContextVar[tuple[Event, ...]] = ContextVar("ultraquiet_interrupts", default=())
# Every task that is shown, the latest last: what happens in threads, which see no listener, is noted there.
_open: list[tuple[Listener, int]] = []


class Task:
    """A handle on one task; does nothing when nobody listens."""

    def __init__(self, listener: Listener | None, key: int) -> None:
        self._listener = listener
        self._key = key

    def advance(self, steps: int = 1, note: str = "") -> None:
        """Report `steps` done, to go on only where the work is wanted."""
        require_wanted()
        if self._listener is not None:
            self._listener.advance(self._key, steps, note)


@contextmanager
def task(title: str, total: int) -> Generator[Task]:
    """Announce work of `total` steps to the listener, for the length of a block.

    Used as `with task("identify", 36) as t: ... t.advance()`.
    """
    listener = _listener.get()
    key = listener.start(title, total) if listener else 0
    if listener:
        _open.append((listener, key))
    try:
        yield Task(listener, key)
    finally:
        if listener:
            _open.remove((listener, key))
            listener.finish(key)


@contextmanager
def noted(note: str) -> Generator[None]:
    """Say for the length of a block what is in hand: beside the latest task, or as a task of its own without any."""
    latest = _open[-1:]
    if not latest:
        with task(note, 1):
            yield
        return
    ((listener, key),) = latest
    listener.advance(key, 0, note)
    try:
        yield
    finally:
        if (listener, key) in _open:
            listener.advance(key, 0, "")


@contextmanager
def listening(listener: Listener) -> Generator[None]:
    """Send all progress inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def require_wanted() -> None:
    """End this work as Ctrl-C would, where whoever waits for it in another thread was interrupted.

    Raises:
        KeyboardInterrupt: it is wanted no more.
    """
    if any(interrupt.is_set() for interrupt in _interrupts.get()):
        raise KeyboardInterrupt


@contextmanager
def wanted_until(*interrupts: Event) -> Generator[None]:
    """Let the work of a block end where it next asks (`require_wanted`) once one of these is set."""
    token = _interrupts.set(interrupts)
    try:
        yield
    finally:
        _interrupts.reset(token)


def interrupts() -> tuple[Event, ...]:
    """Return what ends this work, to be handed on to the threads that it begins."""
    return _interrupts.get()
