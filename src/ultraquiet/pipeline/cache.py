"""A stage and its cache: values in HDF5 files, facts in one JSON file, reused while their key is the same."""

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.provenance import content_hash, plain, versions
from ultraquiet.files import archive, write_bytes
from ultraquiet.files.names import inside

STAGES = "stages"
PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".toml", ".j2")


@dataclass(frozen=True)
class Outcome:
    """What a stage leaves: values by name, facts as JSON's types, and whether it was reused."""

    values: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    reused: bool = False


@dataclass(frozen=True)
class Cache:
    """The folder of a study. `fresh` stages compute; the others are read back."""

    folder: Path

    def stage(
        self, name: str, room: str, key: Any, compute: Callable[[], Outcome], needs: Path | None = None
    ) -> Outcome:
        """Return the stage's outcome, computed unless a finished one with the same key is there.

        Args:
            name: of the stage; its facts go to `stages/NAME.json`.
            room: sub-folder of its values (`records`, `models`, ...).
            key: everything the outcome depends on; versions of the libraries and this package's code are added.
            compute: called when there is nothing to reuse.
            needs: something the stage wrote beside its values; when it is gone the stage is computed again.
        """
        mark = content_hash(key, versions(), _code())
        found = self._read(name, mark) if needs is None or needs.exists() else None
        if found is not None:
            return found
        started = time.perf_counter()
        outcome = compute()
        self._write(name, room, mark, outcome, time.perf_counter() - started)
        return Outcome(outcome.values, json.loads(json.dumps(outcome.facts, default=plain)))

    def _facts(self, name: str) -> Path:
        return self.folder / STAGES / f"{name}.json"

    def _read(self, name: str, mark: str) -> Outcome | None:
        try:
            held = json.loads(self._facts(name).read_text(encoding="utf-8"))
            if held["key"] != mark:
                return None
            paths = {key: PurePosixPath(path).parts for key, path in held["values"].items()}
            values = {key: archive.load(inside("study", self.folder, *parts)) for key, parts in paths.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, UltraquietError):
            return None  # a stage that cannot be read back is computed again
        return Outcome(values, held["facts"], reused=True)

    def _write(self, name: str, room: str, mark: str, outcome: Outcome, seconds: float) -> None:
        paths: dict[str, str] = {}
        try:
            (self.folder / room).mkdir(parents=True, exist_ok=True)
            self._facts(name).parent.mkdir(parents=True, exist_ok=True)
            for key, value in outcome.values.items():
                paths[key] = f"{room}/{key}.h5"
                archive.save(value, self.folder / paths[key])
            held = {"key": mark, "seconds": round(seconds, 3), "values": paths, "facts": outcome.facts}
            write_bytes(self._facts(name), json.dumps(held, indent=1, default=plain).encode())
        except OSError as error:
            raise StorageError(
                f"study: stage '{name}' could not be written under '{self.folder}' ({error}); earlier stages are kept."
            ) from error


@cache
def _code() -> str:
    """Return a hash of this package's own files: a stage computed by other code is another stage."""
    files = sorted(path for path in PACKAGE.rglob("*") if path.suffix in CODE)
    return content_hash([(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files])
