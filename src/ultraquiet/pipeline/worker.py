"""Identify the records of a study folder, as its study says: `python -m ultraquiet.pipeline.worker FOLDER`."""

import sys
from contextlib import suppress
from pathlib import Path

from ultraquiet import files
from ultraquiet._base.beside import Ticks, end_with_parent
from ultraquiet._base.progress import listening
from ultraquiet.pipeline.cache import Cache
from ultraquiet.pipeline.stages import Stages
from ultraquiet.pipeline.store.recorded import finished_names
from ultraquiet.pipeline.study import reload_study
from ultraquiet.values import Record


def main(folder: Path) -> None:
    """Leave the stage `identify` in the folder."""
    names = finished_names(folder)
    records: dict[str, Record] = {name: files.load(folder / "records" / f"{name}.h5") for name in names}
    with listening(Ticks()):
        Stages(reload_study(folder), Cache(folder), None, records, lambda _: None).identify()


if __name__ == "__main__":
    end_with_parent()
    with suppress(KeyboardInterrupt):
        main(Path(sys.argv[1]))
