"""One run at a time in the folder of a study."""

import json
import os
import socket
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from ultraquiet._base.errors import StorageError
from ultraquiet.files import reason
from ultraquiet.pipeline.store.own import require_own

FILE = "study.lock"
# A run that was killed may have a process beside it that is still on its way out.
PATIENCE_S, DYING_S, PAUSE_S = 0.5, 20.0, 0.05


class HeldError(StorageError):
    """Another run holds a folder; `by` says which, as the end of a clause, and is empty where that is not known."""

    def __init__(self, sentence: str, by: str) -> None:
        super().__init__(sentence)
        self.by = by


@contextmanager
def locked(folder: Path, say: Callable[[str], object]) -> Generator[int | None]:
    """Keep every other run out of a folder for the length of a block.

    The system's own lock is taken on `study.lock` and goes with the process that holds it, however that ends; the file
    says who holds it, and is removed at the end. What a killed process left of it blocks nobody. Before the block
    begins nothing has been written that could have left the folder.

    Args:
        folder: of the study; made when absent.
        say: told where the system or the file system knows no locks.

    Yields:
        The open file, for a process that works for this run; None where there are no locks.

    Raises:
        StorageError: another run holds the folder (`HeldError`), and the sentence says which; it cannot be made; what
            stands in it leads out of it (`require_own`).
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        require_own(folder)  # the lock's own file may be a link
        handle = _taken(folder, say)
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise StorageError(
            f"study: '{folder}' cannot be written ({reason(error)}); choose another with --out."
        ) from error
    if handle is None:
        yield None
        return
    try:
        require_own(folder)  # the run that held the lock may have changed it meanwhile
        yield handle
    finally:
        with suppress(OSError):
            (folder / FILE).unlink()
        os.close(handle)


def _taken(folder: Path, say: Callable[[str], object]) -> int | None:
    path, started = folder / FILE, time.monotonic()
    if os.name == "nt":
        say(f"study: this system knows no locks; see that no second run works in '{folder}'.")
        return None
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        taken = False
        try:
            # Whoever held the lock may have removed its file meanwhile: then it is that of a file without a name.
            taken = _try(handle) and _is_at(path, handle)
            if taken:
                _sign(handle)
                return handle
            _refuse_or_wait(folder, _holder(handle), time.monotonic() - started)
        except _NoLocksError as error:
            say(f"study: '{folder}' is on a file system without locks ({error}); see that no second run works there.")
            path.unlink(missing_ok=True)
            return None
        finally:
            if not taken:
                os.close(handle)


class _NoLocksError(Exception):
    """The file system does not know them."""


def _try(handle: int) -> bool:
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise _NoLocksError(reason(error)) from error
    return True


def _refuse_or_wait(folder: Path, holder: dict[str, object], waited_s: float) -> None:
    if waited_s > (DYING_S if _is_gone(holder) else PATIENCE_S):
        by = _named(holder)
        sentence = f"study: another run is at work in '{folder}'{by}; wait until it has ended, or choose another --out."
        raise HeldError(sentence, by)
    time.sleep(PAUSE_S)


def _is_at(path: Path, handle: int) -> bool:
    """Tell whether an open file still has its name."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _sign(handle: int) -> None:
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    text = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since})
    with suppress(OSError):  # on a full disk the lock holds, it only does not say whose it is
        os.ftruncate(handle, 0)
        os.pwrite(handle, text.encode(), 0)


def _holder(handle: int) -> dict[str, object]:
    """Return what the one that holds the lock says of itself; nothing when it is just signing."""
    try:
        content = json.loads(os.pread(handle, 1000, 0))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) and {"pid", "host", "since"} <= set(content) else {}


def _is_gone(holder: dict[str, object]) -> bool:
    """Tell whether the process that took the lock has ended: a child of its own holds it still, and is ending too."""
    pid = holder.get("pid")
    if not isinstance(pid, int) or holder.get("host") != socket.gethostname():
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


def _named(holder: dict[str, object]) -> str:
    return f": process {holder['pid']} on {holder['host']}, since {holder['since']}" if holder else ""
