"""Foreign bytes are understood by a child process that may neither open anything nor take more than its share."""

from ultraquiet.files.confined.run import confined
from ultraquiet.files.confined.unpacked import announce

__all__ = ["announce", "confined"]
