"""The process that computes: `python -m ultraquiet.workbench.jobs.worker FOLDER`, one request a line on its input.

A request is `{"id", "task", "state", "words"}`; it answers with lines of the same `id`: `progress` and `note` while it
works, then either `result` or `failed`, a sentence.
"""

import base64
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Generator
from contextlib import closing, suppress
from pathlib import Path
from threading import Lock, Thread
from typing import Any

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.progress import listening
from ultraquiet.bench.hardware.termination import DEPARTURE
from ultraquiet.experiments import StoppedError
from ultraquiet.workbench.jobs.bench_work import asked_to_stop
from ultraquiet.workbench.jobs.lane import SOFT, SOFT_S
from ultraquiet.workbench.jobs.tasks import TASKS

WATCH_S = 0.1


class Teller:
    """A listener of progress that writes it out as lines."""

    def __init__(self, number: int, out: Any) -> None:
        self._number, self._out, self._lock = number, out, Lock()
        self._tasks: dict[int, list[Any]] = {}

    def start(self, title: str, total: int) -> int:
        """Begin a task."""
        key = len(self._tasks)
        self._tasks[key] = [title, 0, max(1, total)]
        self._tell(key, "")
        return key

    def advance(self, key: int, steps: int, note: str) -> None:
        """Move on."""
        self._tasks[key][1] += steps
        self._tell(key, note)

    def finish(self, key: int) -> None:
        """End a task."""

    def say(self, **words: Any) -> None:
        """Write one line."""
        with self._lock:
            self._out.write(json.dumps({"id": self._number, **words}) + "\n")
            self._out.flush()

    def _tell(self, key: int, note: str) -> None:
        title, done, total = self._tasks[key]
        self.say(progress=min(1.0, done / total), note=f"{title} {note}".strip())


class Attendant(Thread):
    """Looks every `WATCH_S` whether the job of this process is to stop, and whether the server is still there.

    A job that is to stop says how long its bench may need to come to rest. Without a server the process ends, however
    long its job still is: a bench that moves is brought to rest before.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        self._folder, self._parent = folder, os.getppid()
        self.teller: Teller | None = None

    def run(self) -> None:
        """Look until the server is gone."""
        while os.getppid() == self._parent:
            teller = self.teller
            if teller is not None and asked_to_stop(self._folder):
                self.teller = None
                with suppress(OSError):  # nobody is there to hear it
                    teller.say(rest_s=DEPARTURE.way_down_s())
            time.sleep(WATCH_S)
        longest_s = SOFT_S + DEPARTURE.way_down_s()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(longest_s)
        os._exit(1)


def answer(folder: Path, request: dict[str, Any], out: Any, attendant: Attendant | None = None) -> None:
    """Do what one request asks for."""
    teller = Teller(request["id"], out)
    if attendant is not None:
        attendant.teller = teller if request["task"] in SOFT else None
    try:
        with listening(teller):
            result = TASKS[request["task"]](folder, request["state"], **request["words"])
            if isinstance(result, Generator):
                with closing(result):  # an error's traceback would hold it, and what it drives
                    for part in result:
                        teller.say(live={**part, "signals": _text(part["signals"])}, rows=len(part["signals"]))
                result = {}
        teller.say(result=result)
    except Exception as error:
        asked = isinstance(error, StoppedError) and error.asked
        teller.say(failed=_sentence(request["task"], error), asked=asked)


def _sentence(task: str, error: Exception) -> str:
    if isinstance(error, UltraquietError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"{task}: this machine has not enough memory for it; take a shorter record."
    traceback.print_exception(error)  # a fault of this program: the study is untouched, and the page must say so
    return f"{task}: a fault of this program ({type(error).__name__}: {error})."


def _text(signals: Any) -> str:
    return base64.b64encode(signals.tobytes()).decode()


def main() -> None:
    """Answer until the input ends."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints must not stand between the answers
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends its workers
    DEPARTURE.takes_signals()
    folder = Path(sys.argv[1])
    attendant = Attendant(folder)
    attendant.start()
    for line in sys.stdin:
        answer(folder, json.loads(line), out, attendant)
        DEPARTURE.check()


if __name__ == "__main__":
    main()
