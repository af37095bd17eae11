"""Records that were measured elsewhere: a study keeps copies of them, and never in place of what it measured itself."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ultraquiet._base.errors import StorageError
from ultraquiet._base.regular import parse_json, read_regular
from ultraquiet.files import archive, write_bytes
from ultraquiet.pipeline.store.recorded import FOLDER, KEY
from ultraquiet.values import Record


@dataclass(frozen=True)
class Copies:
    """The records of files that a study names, in the folder of the study.

    Args:
        records: what was read, by name.
        folder: of the study.
    """

    records: Mapping[str, Record]
    folder: Path

    def claim(self) -> None:
        """Make sure that nothing but copies stands in the folder.

        Raises:
            StorageError: it holds records that a bench has left, or that no study left.
        """
        place = self.folder / FOLDER
        if any(place.glob("*.h5")) and not self._are_copies(place / KEY):
            raise StorageError(
                f"study: '{place}' holds records that were measured there or that no study left; choose another --out."
            )
        place.mkdir(exist_ok=True)
        kept = {name: record.hash for name, record in self.records.items()}
        content = json.dumps({"bench": None, "measurements": kept, "copies": True}, indent=1).encode()
        if not (place / KEY).exists() or (place / KEY).read_bytes() != content:
            write_bytes(place / KEY, content)

    def take(self) -> dict[str, Record]:
        """Return the records, after copies of those that are not there yet were written."""
        for name, record in self.records.items():
            path = self.folder / FOLDER / f"{name}.h5"
            try:
                there = archive.load(path).hash == record.hash
            except (StorageError, AttributeError):
                there = False
            if not there:
                archive.save(record, path)
        return dict(self.records)

    @staticmethod
    def _are_copies(path: Path) -> bool:
        try:
            return bool(parse_json(read_regular(path))["copies"])
        except (OSError, ValueError, KeyError, TypeError):
            return False
