"""A stage and its cache: values in HDF5 files, facts in one JSON file, reused while their key is the same."""

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from ultraquiet._base.errors import StageError, StorageError, UltraquietError
from ultraquiet._base.provenance import content_hash, versions
from ultraquiet.files import archive, reason, write_bytes
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.store import entry as entries
from ultraquiet.pipeline.store.aside import set_aside
from ultraquiet.pipeline.store.contents import Hashes, changes, hashes_of, place, staged, vouched
from ultraquiet.pipeline.store.entry import StageEntry

PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".toml", ".j2")

Facts = TypeVar("Facts")


def _to_nobody(_: str) -> None: ...


@dataclass(frozen=True)
class Outcome(Generic[Facts]):
    """What a stage leaves: values by the names of their files (`stored.py`), its facts, and whether it was reused."""

    values: Mapping[str, Any]
    facts: Facts
    reused: bool = False


@dataclass(frozen=True)
class Cache:
    """The folder of a study: stages that are there with the same key are read back, the others computed.

    A stage is valid from one rename on, that of `stages/NAME.json`, which holds its key, its facts and the hashes of
    all it left. Values and folders wait under hidden names until then; what a kill leaves half done is either finished
    or swept by the next run. What does not match its hash was changed by hand: that is said, set aside, and made again.

    Args:
        folder: of the study; whoever writes holds its lock.
        say: told what was changed by hand.
        lock: the lock's open file, for processes that work for this run.
    """

    folder: Path
    say: Callable[[str], object] = _to_nobody
    lock: int | None = None

    def stage(
        self,
        name: str,
        room: str,
        key: Any,
        compute: Callable[[], Outcome[Facts]],
        kind: Any = dict,
        writes: str | None = None,
    ) -> Outcome[Facts]:
        """Return the stage's outcome, computed unless a finished one with the same key is there.

        Args:
            name: of the stage; its facts go to `stages/NAME.json`.
            room: sub-folder of its values (`records`, `models`, ...).
            key: everything the outcome depends on; versions of the libraries and this package's code are added.
            compute: called when there is nothing to reuse.
            kind: type of the facts, perhaps a union; a stage whose file holds another shape is computed again. Of a
                plain dictionary every shape will do.
            writes: name of a folder in the room that `compute` leaves in `workplace(room, writes)`.

        Raises:
            StageError: what `compute` raised, with the stage's name.
            StorageError: the outcome cannot be written.
        """
        digest = _digest(key)
        kept = self._kept(name, digest, kind)
        if kept is not None:
            return kept
        started = time.perf_counter()
        try:
            outcome = compute()
        except StorageError:
            raise
        except UltraquietError as error:
            raise StageError(f"study: stage '{name}' failed, those before it are kept: {error}") from error
        try:
            self._keep(name, room, digest, outcome, writes, time.perf_counter() - started)
        except OSError as error:
            raise StorageError(
                f"study: stage '{name}' could not be written under '{self.folder}' ({reason(error)}); earlier stages "
                "are kept."
            ) from error
        return outcome

    def holds(self, name: str, key: Any) -> bool:
        """Tell whether a stage with this key was finished; what it left may still be unreadable."""
        entry = entries.read(self.folder, name)
        return entry is not None and entry.key == _digest(key)

    def workplace(self, room: str, name: str) -> Path:
        """Return an empty hidden folder of the room; what is left in it as `name` becomes the folder `room/name`."""
        hidden = _workplace(self.folder, room, name)
        entries.remove(hidden)
        hidden.mkdir(parents=True)
        return hidden

    def _kept(self, name: str, digest: str, kind: Any) -> Outcome[Facts] | None:
        """Return a finished stage with this key; None where there is none, or where it is not what it was."""
        path, entry = entries.path_of(self.folder, name), entries.read(self.folder, name)
        if entry is None:
            if path.exists() and not entries.is_older(self.folder, name):
                self.say(f"study: stages/{path.name} is damaged or was changed by hand; its stage is made again.")
            return None
        try:
            entries.settle(self.folder, entry)
            if entry.key != digest:
                return None
            for left, hashes in entry.left.items():
                found = hashes_of(place(self.folder, left))
                if found != hashes:
                    self.say(f"study: {left} is not what stage '{name}' left{_how(hashes, found)}; it is made again.")
                    return None
            facts = from_plain(kind, entry.facts)
            values = {key: archive.load(place(self.folder, file)) for key, file in entry.values.items()}
            return Outcome(values, facts, reused=True)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, UltraquietError):
            return None  # a stage that cannot be read back is computed again

    def _keep(
        self, name: str, room: str, digest: str, outcome: Outcome[Any], writes: str | None, seconds: float
    ) -> None:
        """Write what a stage left under hidden names, make way for it, then let one rename make it valid."""
        (self.folder / room).mkdir(parents=True, exist_ok=True)
        entries.path_of(self.folder, name).parent.mkdir(parents=True, exist_ok=True)
        values = {key: f"{room}/{key}.h5" for key in outcome.values}
        left: dict[str, Hashes] = {}
        for key, value in outcome.values.items():
            archive.save(value, staged(self.folder, values[key]))
            left[values[key]] = hashes_of(staged(self.folder, values[key]))
        if writes is not None:
            left[f"{room}/{writes}"] = self._staged_folder(room, writes)
        before = entries.read(self.folder, name)
        known = {} if before is None else {**before.replaced, **before.left}
        for target, hashes in left.items():
            trusted = known.get(target, {})
            if before is None and entries.is_older(self.folder, name):
                trusted = hashes_of(place(self.folder, target))
            self._make_way(target, hashes, trusted)
        replaced = {target: hashes for target, hashes in known.items() if target not in left}
        entry = StageEntry(digest, round(seconds, 3), to_plain(outcome.facts), values, left, replaced)
        write_bytes(entries.path_of(self.folder, name), entries.sealed(entry))
        entries.settle(self.folder, entry)
        if writes is not None:
            entries.remove(_workplace(self.folder, room, writes))

    def _staged_folder(self, room: str, name: str) -> Hashes:
        """Move what was left in the workplace to where a finished folder waits, and return its hashes."""
        made, waiting = _workplace(self.folder, room, name) / name, staged(self.folder, f"{room}/{name}")
        entries.remove(waiting)
        if made.exists():
            made.replace(waiting)
        return hashes_of(waiting)

    def _make_way(self, name: str, coming: Hashes, known: Hashes) -> None:
        """Set aside what a hand has changed where something is going to stand, and remove a folder of its own."""
        path = place(self.folder, name)
        found = hashes_of(path)
        if not vouched(found, known, coming):
            kept = set_aside(path, "edited")
            self.say(f"study: {name} was changed by hand; that is kept as '{kept.relative_to(self.folder)}'.")
        elif path.is_dir():
            entries.remove(path)


def _how(was: Hashes, found: Hashes) -> str:
    """Return what was changed, in brackets; of a file alone, only whether it is there."""
    if "" in was or "" in found:
        return " (edited)" if found else " (deleted)"
    return f" ({changes(was, found) or 'changed'})"


def _workplace(folder: Path, room: str, name: str) -> Path:
    return folder / room / f".{name}.work.part"


def _digest(key: Any) -> str:
    return content_hash(key, versions(), _code())


@cache
def _code() -> str:
    """Return a hash of this package's own files: a stage computed by other code is another stage."""
    files = sorted(path for path in PACKAGE.rglob("*") if path.suffix in CODE)
    return content_hash([(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files])
