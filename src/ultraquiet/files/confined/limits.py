"""What a process that reads foreign bytes gives up, for good: memory, time, and whatever it could open.

Memory, processor time and the length of what it writes are bounded by `setrlimit`; so is the number of files, at none.
Where the kernel knows Landlock (Linux 5.13), no path can be opened, made, renamed or removed either, outside a scratch
folder where there is one; and Python itself refuses programs and connections. Nothing of this can be taken back.
"""

import contextlib
import ctypes
import encodings.ascii
import encodings.cp437
import encodings.latin_1
import encodings.utf_8_sig
import encodings.utf_16
import encodings.utf_16_be
import encodings.utf_16_le
import encodings.utf_32
import encodings.utf_32_be
import encodings.utf_32_le  # noqa: F401  Python loads an encoding when it is first used: too late behind closed doors
import os
import struct
import sys
from pathlib import Path
from typing import Any

ROOM_BYTES = 768 << 20  # beyond what the process has and twice what is delivered: under 1 GB above the data
SCRATCH_FILES = 64  # open at once, in a scratch folder

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # the same on every processor, linux/landlock.h
_PATH_BENEATH, _VERSION_FLAG, _NO_NEW_PRIVILEGES = 1, 1, 38
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # bits of file access that each version of Landlock knows
_FORBIDDEN = ("subprocess.", "os.exec", "os.fork", "os.posix_spawn", "os.system", "os.kill", "socket.", "pty.")

_begun: list[int] = []  # address space when the limits came into force; empty in a process without limits


def restrict(most_bytes: int, most_s: int, scratch: Path | None) -> None:
    """Bind this process; it should be a child that reads one file and ends.

    Args:
        most_bytes: how much it may deliver.
        most_s: processor time.
        scratch: a folder in which it may work, for readers that know named files only.
    """
    import resource

    begun = address_bytes()
    _begun[:] = [begun]
    files = SCRATCH_FILES if scratch else 0
    hard = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_CPU: most_s,
        resource.RLIMIT_FSIZE: most_bytes,
    }
    for which, most in hard.items():
        resource.setrlimit(which, (most, most))
    most = begun + ROOM_BYTES + 2 * most_bytes
    with contextlib.suppress(OSError, ValueError):  # macOS bounds no address space
        resource.setrlimit(resource.RLIMIT_AS, (begun + ROOM_BYTES, most))
    _close_paths(scratch)
    resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    sys.addaudithook(_audited)


def allow(count: int) -> None:
    """Give room for `count` bytes of numbers and their copy, which the file's size accounts for."""
    if not _begun:
        return
    import resource

    with contextlib.suppress(OSError, ValueError):
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (min(_begun[0] + ROOM_BYTES + 2 * count, most), most))


def address_bytes() -> int:
    """Return the address space that this process takes; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return 0


def _audited(event: str, _: tuple[Any, ...]) -> None:
    if event.startswith(_FORBIDDEN):
        raise PermissionError(f"{event} while foreign bytes are read")


def _close_paths(scratch: Path | None) -> None:
    """Forbid every path but those below the scratch folder, where the kernel can."""
    if sys.platform != "linux":
        return
    call = ctypes.CDLL(None, use_errno=True)
    version = call.syscall(_CREATE_RULESET, None, 0, _VERSION_FLAG)
    if version < 1:
        return
    rights = (1 << _RIGHTS[min(version, max(_RIGHTS))]) - 1
    ruleset = call.syscall(_CREATE_RULESET, struct.pack("=Q", rights), 8, 0)
    if ruleset < 0:
        return
    if scratch is not None:
        folder = os.open(scratch, os.O_RDONLY | os.O_DIRECTORY)
        call.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("=Qi", rights, folder), 0)
        os.close(folder)
    call.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    call.syscall(_RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)
