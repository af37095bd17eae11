"""What a file says it unpacks into, held against its size before anything is unpacked."""

from ultraquiet._base.errors import StorageError
from ultraquiet.files.confined.limits import allow
from ultraquiet.files.sizes import sized

FREE_BYTES = 256 << 20  # any file may unpack into that: a short one of zeros is nobody's bomb
SWELL = 32  # beyond it, times the file's size: measured signals pack to a quarter at best, silent channels further


def budget_bytes(file_bytes: int) -> int:
    """Return into how many bytes of numbers a file of this size may unpack.

    >>> budget_bytes(1 << 30) >> 30
    32
    """
    return FREE_BYTES + SWELL * file_bytes


def announce(name: str, count: int, file_bytes: int) -> None:
    """Refuse a file that says it unpacks into more than its size accounts for; a reader calls this first.

    Args:
        name: the file.
        count: bytes of the numbers it says it holds, as float64.
        file_bytes: its size.

    Raises:
        StorageError: more than `budget_bytes`.

    >>> announce("small.npz", 8000, 500)
    """
    budget = budget_bytes(file_bytes)
    if count > budget:
        raise StorageError(
            f"read_record: '{name}' says it unpacks into {sized(count)}, of a file with {sized(file_bytes)}; up to "
            f"{sized(budget)} are unpacked of such a file: it is damaged, made to fill the memory, or to be cut up."
        )
    allow(count)
