"""Identify the records of a study folder, as its study says: `python -m ultraquiet.pipeline.worker FOLDER`."""

import sys
from contextlib import suppress
from pathlib import Path

from ultraquiet import files
from ultraquiet._base.beside import Ticks
from ultraquiet._base.progress import listening
from ultraquiet.pipeline.cache import Cache
from ultraquiet.pipeline.stages import Stages
from ultraquiet.pipeline.study import reload_study
from ultraquiet.values import Record


def main(folder: Path) -> None:
    """Leave the stage `identify` in the folder."""
    loaded = {path.stem: files.load(path) for path in sorted((folder / "records").glob("*.h5"))}
    records = {name: record for name, record in loaded.items() if isinstance(record, Record)}
    with listening(Ticks()):
        Stages(reload_study(folder), Cache(folder), None, records, lambda _: None).identify()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(Path(sys.argv[1]))
