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
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import Any

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.progress import listening
from ultraquiet.workbench.jobs.tasks import TASKS

PARENT_S = 1.0


class Teller:
    """A listener of progress that writes it out as lines."""

    def __init__(self, number: int, out: Any) -> None:
        self._number, self._out = number, out
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
        self._out.write(json.dumps({"id": self._number, **words}) + "\n")
        self._out.flush()

    def _tell(self, key: int, note: str) -> None:
        title, done, total = self._tasks[key]
        self.say(progress=min(1.0, done / total), note=f"{title} {note}".strip())


def answer(folder: Path, request: dict[str, Any], out: Any) -> None:
    """Do what one request asks for."""
    teller = Teller(request["id"], out)
    try:
        with listening(teller):
            result = TASKS[request["task"]](folder, request["state"], **request["words"])
            if isinstance(result, Iterator):
                for part in result:
                    teller.say(live={**part, "signals": _text(part["signals"])}, rows=len(part["signals"]))
                result = {}
        teller.say(result=result)
    except UltraquietError as error:
        teller.say(failed=str(error))
    except MemoryError:
        teller.say(failed=f"{request['task']}: this machine has not enough memory for it; take a shorter record.")
    except Exception as error:  # a fault of this program: the study is untouched, and the page must say so
        traceback.print_exc()
        teller.say(failed=f"{request['task']}: a fault of this program ({type(error).__name__}: {error}).")


def _text(signals: Any) -> str:
    return base64.b64encode(signals.tobytes()).decode()


def _end_with(parent: int) -> None:
    """End this process when the server is gone, however long its job still is."""
    while os.getppid() == parent:
        time.sleep(PARENT_S)
    os._exit(1)


def main() -> None:
    """Answer until the input ends."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints must not stand between the answers
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends its workers
    Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    for line in sys.stdin:
        answer(Path(sys.argv[1]), json.loads(line), out)


if __name__ == "__main__":
    main()
