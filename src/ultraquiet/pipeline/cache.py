"""A stage and its cache: values in HDF5 files, facts in one JSON file, reused while their key is the same."""

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Generic, TypeVar

from ultraquiet._base.errors import StageError, StorageError, UltraquietError
from ultraquiet._base.provenance import content_hash, versions
from ultraquiet.files import archive, write_bytes
from ultraquiet.files.names import inside
from ultraquiet.pipeline.facts.typed import from_plain, to_plain

STAGES = "stages"
PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".toml", ".j2")

Facts = TypeVar("Facts")


@dataclass(frozen=True)
class Outcome(Generic[Facts]):
    """What a stage leaves: its facts, and values by the names of their files (`stored.py`)."""

    facts: Facts
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Cache:
    """The folder of a study: stages that are there with the same key are read back, the others computed."""

    folder: Path

    def stage(
        self,
        name: str,
        room: str,
        key: Any,
        kind: Any,
        compute: Callable[[], Outcome[Facts]],
        needs: Path | None = None,
    ) -> Outcome[Facts]:
        """Return the stage's outcome, computed unless a finished one with the same key is there.

        Args:
            name: of the stage; its facts go to `stages/NAME.json`.
            room: sub-folder of its values (`records`, `models`, ...).
            key: everything the outcome depends on; versions of the libraries and this package's code are added.
            kind: type of the facts, perhaps a union; a stage whose file holds another shape is computed again.
            compute: called when there is nothing to reuse.
            needs: something the stage wrote beside its values; when it is gone the stage is computed again.

        Raises:
            StageError: what `compute` raised, with the stage's name.
            StorageError: the outcome cannot be written.
        """
        digest = _digest(key)
        kept = self._read(name, digest, kind) if needs is None or needs.exists() else None
        if kept is not None:
            return kept
        started = time.perf_counter()
        try:
            outcome = compute()
        except UltraquietError as error:
            raise StageError(f"study: stage '{name}' failed, those before it are kept: {error}") from error
        self._write(name, room, digest, outcome, time.perf_counter() - started)
        return outcome

    def holds(self, name: str, key: Any) -> bool:
        """Tell whether a stage with this key was finished; what it left may still be unreadable."""
        try:
            return bool(json.loads(self._path(name).read_text(encoding="utf-8"))["key"] == _digest(key))
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def _path(self, name: str) -> Path:
        return self.folder / STAGES / f"{name}.json"

    def _read(self, name: str, digest: str, kind: Any) -> Outcome[Facts] | None:
        try:
            content = json.loads(self._path(name).read_text(encoding="utf-8"))
            if content["key"] != digest:
                return None
            facts = from_plain(kind, content["facts"])
            paths = {key: PurePosixPath(path).parts for key, path in content["values"].items()}
            values = {key: archive.load(inside("study", self.folder, *parts)) for key, parts in paths.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, UltraquietError):
            return None  # a stage that cannot be read back is computed again
        return Outcome(facts, values)

    def _write(self, name: str, room: str, digest: str, outcome: Outcome[Any], seconds: float) -> None:
        paths: dict[str, str] = {}
        try:
            (self.folder / room).mkdir(parents=True, exist_ok=True)
            self._path(name).parent.mkdir(parents=True, exist_ok=True)
            for key, value in outcome.values.items():
                paths[key] = f"{room}/{key}.h5"
                archive.save(value, self.folder / paths[key])
            facts = to_plain(outcome.facts)
            content = {"key": digest, "seconds": round(seconds, 3), "values": paths, "facts": facts}
            write_bytes(self._path(name), json.dumps(content, indent=1).encode())
        except OSError as error:
            raise StorageError(
                f"study: stage '{name}' could not be written under '{self.folder}' ({error}); earlier stages are kept."
            ) from error


def _digest(key: Any) -> str:
    return content_hash(key, versions(), _code())


@cache
def _code() -> str:
    """Return a hash of this package's own files: a stage computed by other code is another stage."""
    files = sorted(path for path in PACKAGE.rglob("*") if path.suffix in CODE)
    return content_hash([(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files])
