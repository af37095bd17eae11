"""Identify the records of a study folder, as its study says: `python -m ultraquiet.pipeline.worker FOLDER`."""

import sys
from contextlib import suppress
from pathlib import Path

from ultraquiet import files
from ultraquiet._base.progress import listening
from ultraquiet.pipeline.ahead import TICKS
from ultraquiet.pipeline.cache import Cache
from ultraquiet.pipeline.stages import Stages
from ultraquiet.pipeline.study import reload_study
from ultraquiet.values import Record


class Ticks:
    """Prints how many hundredths of the largest task were done since the last line."""

    def __init__(self) -> None:
        self._total, self._done, self._told = 1, 0, 0

    def start(self, title: str, total: int) -> int:
        """Begin a task."""
        self._total = max(self._total, total)
        return 0

    def advance(self, key: int, steps: int, note: str) -> None:
        """Move on."""
        self._done += steps
        share = min(TICKS, TICKS * self._done // self._total)
        if share > self._told:
            print(share - self._told, flush=True)
            self._told = share

    def finish(self, key: int) -> None:
        """End a task."""


def main(folder: Path) -> None:
    """Leave the stage `identify` in the folder."""
    loaded = {path.stem: files.load(path) for path in sorted((folder / "records").glob("*.h5"))}
    records = {name: record for name, record in loaded.items() if isinstance(record, Record)}
    with listening(Ticks()):
        Stages(reload_study(folder), Cache(folder), None, records, lambda _: None).identify()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(Path(sys.argv[1]))
