"""What a run that was killed left half done in the folder of a study is finished or removed before another begins."""

import re
from contextlib import suppress
from pathlib import Path

from ultraquiet.pipeline.store.entry import remove, settle_all
from ultraquiet.pipeline.store.own import ROOMS

# Hidden names that this program gives: `write_bytes` ends them with twelve hexadecimal digits, a stage that is not
# valid yet with `.part` alone.
TORN = re.compile(r"\..+\.(?:[0-9a-f]{12}|h5|work)\.part")
TORN_HERE = re.compile(
    r"\.(?:summary\.json|campaign\.json|campaign\.parquet|study\.json|report\.html)\.[0-9a-f]{12}\.part"
)


def sweep(folder: Path) -> None:
    """Finish stages that had become valid, and remove everything that waits under a hidden name.

    Only for whoever holds the folder's lock.

    Raises:
        OSError: the disk refuses.
    """
    settle_all(folder)
    for path in folder.iterdir():
        if TORN_HERE.fullmatch(path.name):
            remove(path)
    for room in ROOMS:
        with suppress(FileNotFoundError, NotADirectoryError):
            for path in (folder / room).iterdir():
                if TORN.fullmatch(path.name) or (room == "code" and re.fullmatch(r"\..+\.part", path.name)):
                    remove(path)
