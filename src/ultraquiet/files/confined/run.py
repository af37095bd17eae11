"""One reader on one file's bytes, in a child process of its own."""

import contextlib
import gc
import os
import select
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ultraquiet._base import errors
from ultraquiet._base.errors import StorageError, UltraquietError, signal_name
from ultraquiet._base.shown.one_line import printable
from ultraquiet.files.confined import limits, transport
from ultraquiet.files.confined.unpacked import budget_bytes
from ultraquiet.files.whole import READER, understanding

LEAST_S, BYTES_PER_S = 6, 2 << 20  # processor time for any file, and beyond it by its size: text takes longest
WAIT = 4  # wall time, times processor time: the machine may have other things to do
HEAD_BYTES = 1 << 20  # of what is delivered beside numbers


def confined(
    read: Callable[[], Any], name: str, kind: str, file_bytes: int, scratch: bool = False, who: str = READER
) -> Any:
    """Return what `read` makes of foreign bytes, a plain tree, or say in one sentence why there is none.

    `read` runs in a child of this process that shares its memory as it was and nothing else: see `limits`. A library
    that crashes, hangs or takes all memory does so there. Modules it needs must have been imported already. Where
    there is no `fork` (Windows) it runs here, with the checks of sizes alone.

    Args:
        read: makes a tree as `transport.send` takes it, of bytes it holds.
        name: the file, for the sentence.
        kind: the name of the format.
        file_bytes: the file's size, which bounds memory and time.
        scratch: the reader knows named files only and gets an empty folder for them, `tempfile.tempdir`.
        who: refuses, in the sentence.

    Raises:
        UltraquietError: what `read` raised, or StorageError for all else.
    """
    if not hasattr(os, "fork"):
        with understanding(name, kind, who):
            return read()
    most_s = LEAST_S + file_bytes // BYTES_PER_S
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory())) if scratch else None
        out = _unnamed(stack)
        child = _forked(
            lambda: _answer(read, name, kind, who), out, budget_bytes(file_bytes) + HEAD_BYTES, most_s, folder
        )
        how = _ended(child, most_s * WAIT)
        if how:
            raise StorageError(f"{who}: '{name}' cannot be read as {kind} ({how}).")
        return _delivered(out, name, kind, who)


def _unnamed(stack: contextlib.ExitStack) -> int:
    if hasattr(os, "memfd_create"):
        out = os.memfd_create("ultraquiet")
        stack.callback(os.close, out)
        return out
    return stack.enter_context(tempfile.TemporaryFile()).fileno()


def _forked(answer: Callable[[], Any], out: int, most_bytes: int, most_s: int, scratch: Path | None) -> int:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    with warnings.catch_warnings():
        # Threads of this process do not exist in the child, which takes no lock of theirs.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child:
        return child
    try:
        gc.disable()  # what others left lying about is not cleared away twice
        _alone(out)
        if scratch is not None:
            tempfile.tempdir = str(scratch)
        limits.restrict(most_bytes, most_s, scratch)
        transport.send(out, answer())
        os._exit(0)
    except BaseException:
        os._exit(1)


def _alone(keep: int) -> None:
    """Let go of every file of the parent, its pipes, locks and sockets, and of its signal handlers."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(nothing, standard)
    os.closerange(3, keep)
    os.closerange(keep + 1, max(keep + 1, os.sysconf("SC_OPEN_MAX")))


def _answer(read: Callable[[], Any], name: str, kind: str, who: str) -> dict[str, Any]:
    try:
        with understanding(name, kind, who):
            return {"tree": read()}
    except UltraquietError as error:
        return {"error": type(error).__name__, "sentence": str(error)}


def _ended(child: int, most_s: float) -> str:
    """Wait for the child; return how it failed, or nothing."""
    code = None
    try:
        code = _waited(child, most_s)
    finally:
        if code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    if code is None or code in (-signal.SIGXCPU, -signal.SIGKILL):
        return "reading it takes longer, or more memory, than a file of its size may"
    if code < 0:
        return f"what reads it crashed on it with {signal_name(-code)}: it is damaged, or made to do that"
    return "it takes more memory than a file of its size may" if code else ""


def _waited(child: int, most_s: float) -> int | None:
    if hasattr(os, "pidfd_open"):
        with contextlib.suppress(OSError):
            handle = os.pidfd_open(child)
            try:
                poll = select.poll()
                poll.register(handle, select.POLLIN)
                ready = poll.poll(1000 * most_s)
            finally:
                os.close(handle)
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) if ready else None
    end, pause = time.monotonic() + most_s, 1e-4
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(pause)
        pause = min(2 * pause, 0.05)
    return None


def _delivered(out: int, name: str, kind: str, who: str) -> Any:
    try:
        answer = transport.receive(out)
        if "tree" in answer:
            return answer["tree"]
        raised = getattr(errors, answer["error"], StorageError)
    except (ValueError, KeyError, TypeError) as error:
        raise StorageError(f"{who}: '{name}' cannot be read as {kind} ({error}).") from error
    raise raised(printable(str(answer["sentence"]), kept="\n"))
