"""Being ended from outside, by `kill` or a closed terminal: an exception, as Ctrl-C is, while something is up."""

import signal
import threading
from types import FrameType
from typing import Any

# SIGKILL and a power cut reach no program: against them only a watch-dog in the hardware helps.
# Windows knows neither SIGHUP nor SIGQUIT.
ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))
FATAL = 128  # the shell's exit code of a program that a signal ended is this much more


class Termination:
    """Turns signals that would end Python on the spot into SystemExit, between `hold` and `release`.

    Handlers that somebody else has installed stay in charge, and what is ignored stays ignored (SIGHUP under `nohup`);
    outside the main thread nothing can be done.
    """

    def __init__(self) -> None:
        self._before: dict[signal.Signals, Any] = {}

    def hold(self) -> None:
        """From here on an end from outside is an exception."""
        if threading.current_thread() is threading.main_thread():
            for number in ENDINGS:
                if signal.getsignal(number) is signal.SIG_DFL:
                    self._before[number] = signal.signal(number, _leave)

    def release(self) -> None:
        """From here on it is sudden again."""
        if threading.current_thread() is threading.main_thread():
            while self._before:
                signal.signal(*self._before.popitem())


def _leave(number: int, frame: FrameType | None) -> None:
    del frame
    raise SystemExit(FATAL + number)
