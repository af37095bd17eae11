"""Room `cli`: the command line, one file a command.

May be changed here: words, options and how results are printed. No computation: every command calls a room below.
"""

import os
import signal
import sys
import threading

from ultraquiet._base.errors import Interrupting

# Linear algebra here is many small problems: threads inside each of them cost more than they give, and fight with the
# threads that identify channels side by side. Must be set before NumPy loads its BLAS.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

__all__ = ["main"]

TERMINATING = ("SIGTERM", "SIGHUP")  # of a supervisor, and of a terminal that closes; Windows knows no SIGHUP


def main() -> None:
    """Run the command line; Ctrl-C ends it as it does later, also while half a second of imports is not over.

    SIGTERM and SIGHUP do what Ctrl-C does: the same sentence, the same code. What is ignored, under `nohup`, stays so.
    """
    try:
        _interrupted_by(TERMINATING)
        from ultraquiet.cli.app import main as run
    except KeyboardInterrupt:
        sys.stderr.write("ultraquiet: stopped before it began.\n")
        sys.exit(130)
    run()


def _interrupted_by(names: tuple[str, ...]) -> None:
    if threading.current_thread() is not threading.main_thread():
        return  # signals reach the main thread alone, and are its own to take
    handler = Interrupting()
    for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, handler)
