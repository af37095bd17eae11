"""A lane of work: one process that does one job after the other, and what becomes of a job when it is killed."""

import base64
import json
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from threading import RLock, Thread, Timer
from typing import Any

import numpy as np

from ultraquiet._base.errors import signal_name
from ultraquiet.workbench.engine.items import FOLDER

WORKER = "ultraquiet.workbench.jobs.worker"
STOP_FILE = "stop"
# Who may move a bench is asked to bring it to rest, and killed when that takes longer than the bench needs. Those of
# `ASKING` look for the stop file themselves; the others are told by SIGTERM.
SOFT, ASKING, SOFT_S = ("live", "measure", "close", "run"), ("live", "measure"), 2.0
POLL_S = 0.02
_numbers = count(1)


@dataclass(eq=False)
class WorkItem:
    """One piece of work: `waiting`, `running`, `done`, `failed` or `cancelled`; `sentence` says why it failed."""

    task: str
    title: str
    state: Mapping[str, Any]
    words: Mapping[str, Any]
    then: Callable[["WorkItem"], object] | None = None
    live: Callable[[dict[str, Any]], object] | None = None
    number: int = field(default_factory=lambda: next(_numbers))
    status: str = "waiting"
    progress: float = 0.0
    note: str = ""
    sentence: str = ""
    result: Any = None
    started: float = 0.0
    seconds: float = 0.0
    stopping: bool = False
    ended: bool = False
    asked: float = 0.0
    rest_s: float = 0.0

    @property
    def over(self) -> bool:
        """Whether it has ended, one way or the other."""
        return self.status in ("done", "failed", "cancelled")


class Lane:
    """Jobs in their order, in a process of their own that is started anew when it dies.

    Args:
        folder: of the study.
        told: called after every change.
    """

    def __init__(self, folder: Path, told: Callable[[], object]) -> None:
        self._folder, self._told = folder, told
        self._lock = RLock()
        self._waiting: deque[WorkItem] = deque()
        self._current: WorkItem | None = None
        self._process: subprocess.Popen[str] | None = None
        self._closed = False

    def warm(self) -> None:
        """Start the process before there is work for it."""
        with self._lock:
            self._running()

    def submit(self, job: WorkItem) -> WorkItem:
        """Take a job."""
        with self._lock:
            self._waiting.append(job)
            self._next()
        self._told()
        return job

    def cancel(self, job: WorkItem) -> None:
        """End a job; what it had finished is kept."""
        with self._lock:
            if job in self._waiting:
                self._waiting.remove(job)
                self._end(job, "cancelled", f"{job.title}: cancelled before it began.")
            elif job is self._current and job.task in SOFT:
                self._ask(job)
            elif job is self._current:
                self._break_off(job)
        self._told()

    def close(self) -> None:
        """End the process and all work; what moves a bench is brought to rest before."""
        with self._lock:
            self._closed = True
            job = self._current
            if job is not None and job.task in SOFT:
                self._ask(job)
        while job is not None and job.stopping and not job.over:  # its time is limited by `_lose_patience`
            time.sleep(POLL_S)
        with self._lock:
            self._kill()

    @property
    def pid(self) -> int | None:
        """The process, where one runs."""
        return None if self._process is None else self._process.pid

    def _ask(self, job: WorkItem) -> None:
        """Ask a job that may move a bench to bring it to rest; asked again, it goes on doing so."""
        if job.stopping:
            return
        job.stopping = True
        (self._folder / FOLDER / STOP_FILE).touch()
        self._press(job, ended=job.task not in ASKING)

    def _press(self, job: WorkItem, ended: bool) -> None:
        """Give a job its time to bring a bench to rest; where `ended`, its process is told to end by itself."""
        job.asked, job.ended = time.monotonic(), ended
        if ended and self._process is not None:
            self._process.terminate()
        Timer(SOFT_S, self._lose_patience, [job]).start()

    def _lose_patience(self, job: WorkItem) -> None:
        """End the process of a job that has gone on for longer than its bench needs, and kill it the next time."""
        with self._lock:
            if job is not self._current:
                return
            left_s = job.asked + SOFT_S + job.rest_s - time.monotonic()
            if left_s > 0:
                Timer(left_s, self._lose_patience, [job]).start()
            elif not job.ended:
                self._press(job, ended=True)
            else:
                self._break_off(job)
        self._told()

    def _break_off(self, job: WorkItem) -> None:
        self._current = None
        self._cancelled(job)
        self._kill()
        self._next()

    def _cancelled(self, job: WorkItem) -> None:
        self._end(job, "cancelled", f"{job.title}: cancelled; what was finished before is kept.")

    def _next(self) -> None:
        if self._current is not None or not self._waiting or self._closed:
            return
        job = self._current = self._waiting.popleft()
        job.status, job.started = "running", time.monotonic()
        if job.task in SOFT:  # the other lanes have the same file
            (self._folder / FOLDER / STOP_FILE).unlink(missing_ok=True)
        request = {"id": job.number, "task": job.task, "state": job.state, "words": job.words}
        process = self._running()
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
        except OSError:
            pass  # it has just died: its reader says so

    def _running(self) -> "subprocess.Popen[str]":
        if self._process is None or self._process.poll() is not None:
            command = [sys.executable, "-m", WORKER, str(self._folder)]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, encoding="utf-8")
            Thread(target=self._read, args=(self._process,), daemon=True).start()
        return self._process

    def _read(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None
        assert process.stdin is not None
        for line in process.stdout:
            with self._lock, suppress(ValueError):  # half a line, of a process that has ended meanwhile
                self._heard(json.loads(line))
            self._told()
        code = process.wait()
        process.stdout.close()
        with suppress(OSError):  # what it was told last may never have reached it
            process.stdin.close()
        with self._lock:
            if process is self._process:
                self._process = None
                job, self._current = self._current, None
                if job is not None and job.stopping:
                    self._cancelled(job)
                elif job is not None:
                    self._end(job, "failed", f"{job.title}: {_ended(code)}; the study is intact, start it again.")
                self._next()
        self._told()

    def _heard(self, words: Mapping[str, Any]) -> None:
        job = self._current
        if job is None or words["id"] != job.number:
            return
        if "result" in words or "failed" in words:
            self._over(job, words)
        elif "rest_s" in words:
            job.rest_s = words["rest_s"]
        elif "live" in words:
            if job.live is not None:
                raw = np.frombuffer(base64.b64decode(words["live"]["signals"]), "<f4")
                job.live({**words["live"], "signals": raw.reshape(words["rows"], -1)})
        else:
            job.progress, job.note = words["progress"], words["note"]

    def _over(self, job: WorkItem, words: Mapping[str, Any]) -> None:
        self._current = None
        if job.ended:
            self._process = None  # it ends by itself, and takes no other job
        if "result" in words:
            job.result = words["result"]
            self._end(job, "done", "")
        elif words["asked"]:
            self._cancelled(job)
        else:
            self._end(job, "failed", words["failed"])
        self._next()

    def _end(self, job: WorkItem, status: str, sentence: str) -> None:
        job.seconds = time.monotonic() - job.started if job.started else 0.0
        job.status, job.sentence = status, sentence
        if job.then is not None:
            job.then(job)

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()


def _ended(code: int) -> str:
    """Return how a process ended, in words.

    >>> _ended(-9), _ended(1)
    ('its process was killed (SIGKILL)', 'its process ended (exit code 1)')
    """
    if code < 0:
        return f"its process was killed ({signal_name(-code)})"
    return f"its process ended (exit code {code})"
