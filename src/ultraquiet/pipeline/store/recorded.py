"""The records of a study: taken up when list and bench are the same, set aside when asked, never removed."""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from glob import escape
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import experiments, files
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.regular import parse_json, read_regular
from ultraquiet.experiments import journal
from ultraquiet.experiments.plan import Measurement, Pause
from ultraquiet.files import write_bytes
from ultraquiet.pipeline.store.identity import differences, settled
from ultraquiet.values import Record

FOLDER, KEY = "records", "list.key"
OLDER_KEY_BYTES = 64  # one hash of list and bench, as version 0.2 wrote it
NAMED = 3  # differences that a sentence tells


@dataclass(frozen=True)
class Records:
    """The records of a list on a bench, in the folder of a study.

    Args:
        listed: the list, planned for the bench.
        bench: what measures.
        describe: returns what defines it (`identity`).
        folder: of the study.
        say: told when records are set aside.
    """

    listed: experiments.ExperimentList
    bench: Any
    describe: Callable[[], Mapping[str, Any]]
    folder: Path
    say: Callable[[str], object]

    def claim(self, again: bool = False) -> None:
        """Make sure that what stands in the folder belongs to this list on this bench; nothing else is changed.

        Args:
            again: set finished records aside and measure anew, whatever they belong to.

        Raises:
            StorageError: records that no study left, or those of another list or bench; the sentence says what
                differs and what would do.
        """
        was, present = self._key(), self._present()
        now: dict[str, Any] = json.loads(json.dumps({"bench": self.describe(), "measurements": _measured(self.listed)}))
        reason = self._reason(was, now, present)
        whole = all((self._place / f"{m.name}.h5").exists() for m in self.listed.measurements)
        if present and again and was is not None and (reason or whole):
            self._set_aside()
        elif reason:
            raise StorageError(f"study: {reason}")
        elif was and present:
            # Records of measurements that the list has no more keep their line: it says whose they are.
            known = {**was.get("earlier", {}), **was["measurements"]}
            now["bench"] = settled(was["bench"], now["bench"])
            earlier = {name: key for name, key in known.items() if name not in now["measurements"] and name in present}
            now |= {"earlier": earlier} if earlier else {}
        self._write(now)

    @property
    def bench_key(self) -> Any:
        """What defines the bench that these records were made on."""
        return (self._key() or {}).get("bench")

    def take(self, stop: Callable[[], bool] | None = None) -> dict[str, Record]:
        """Return the records by their names, measured where they are not there yet; `stop` as in `experiments.run`.

        Raises:
            StorageError: a record is not the one that was measured, and whatever `experiments.run` raises.
        """
        names = [m.name for m in self.listed.measurements]
        missing = self.missing_samples
        how: dict[str, Any] = {"resume": True, "repeat": names, "onlooker": _Told(self.say)}
        how |= {} if stop is None else {"stop": stop}
        records = experiments.run(self.listed, self._place, self.bench, **how)
        measured = {e["name"]: e["record"] for e in journal.entries(self._place) if e["event"] == "finished"}
        for name, record in records.items():
            if measured.get(name, record.hash) != record.hash:
                raise StorageError(
                    f"study: '{self._place / name}.h5' holds other samples than were measured; put the file back that "
                    "was there, or set all records aside with --record-again and measure anew."
                )
            _drop_beginnings(self._place, name, record)
        key = self._key()
        if key and missing:
            # What a bench writes while it runs, a diary named in its command, does not define it.
            self._write({**key, "bench": settled(key["bench"], json.loads(json.dumps(self.describe())))})
        return records

    @property
    def missing_samples(self) -> int:
        """How many samples of the list were not measured yet."""
        present = set(self._present())
        return sum(m.samples for m in self.listed.measurements if m.name not in present)

    @property
    def _place(self) -> Path:
        return self.folder / FOLDER

    def _present(self) -> list[str]:
        """Return the names of what was measured there, whole or not."""
        endings = (".h5", ".log")
        return sorted({p.stem for p in self._place.glob("[!.]*") if p.suffix in endings and p.is_file()})

    def _key(self) -> dict[str, Any] | None:
        """Return what the records were made from; None where nothing says so, empty where it cannot be told."""
        path = self._place / KEY
        try:
            text = read_regular(path)
            content = parse_json(text) if len(text) != OLDER_KEY_BYTES else {}
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            return {}
        if not content and text == _older_key(self.listed, self.bench):
            return {"bench": self.describe(), "measurements": _measured(self.listed)}
        return content if isinstance(content, dict) and {"bench", "measurements"} <= set(content) else {}

    def _reason(self, was: Mapping[str, Any] | None, now: Mapping[str, Any], present: list[str]) -> str:
        """Return why the records that are present may not be taken for this study's; empty where they may."""
        asked = {m.name for m in self.listed.measurements}
        if not present:
            return ""
        if was is None:
            foreign = [name for name in present if name in asked]
            if not foreign:
                return ""
            return f"'{self._place}' holds records that no study left ({foreign[0]}, ...); choose another --out."
        if not was:
            return self._refusal("it cannot be told which list and bench they belong to")
        changed = [f"the bench's {each}" for each in differences(was["bench"] or {}, now["bench"])]
        before: dict[str, Any] = {**was.get("earlier", {}), **was["measurements"]}
        for name in (name for name in present if name in asked):
            if before.get(name) != now["measurements"][name]:
                changed.append(f"the list's '{name}' is another measurement or in another place")
        more = f", and {len(changed) - NAMED} more" if len(changed) > NAMED else ""
        return self._refusal("; ".join(changed[:NAMED]) + more) if changed else ""

    def _refusal(self, why: str) -> str:
        return (
            f"'{self._place}' holds records of another list or bench, which are kept: {why}. Choose another --out, or "
            "--record-again, which sets them aside and measures anew."
        )

    def _write(self, key: Mapping[str, Any]) -> None:
        path, text = self._place / KEY, json.dumps(key, indent=1).encode()
        self._place.mkdir(exist_ok=True)
        if not path.exists() or read_regular(path) != text:
            write_bytes(path, text)

    def _set_aside(self) -> None:
        for number in count(1):
            target = self.folder / f"{FOLDER}.{number}"
            if not target.exists():
                self._place.rename(target)
                self.say(f"study: the records that were there are kept as '{target}'; they are measured anew.")
                return


class _Told(experiments.Onlooker):
    """Passes on what a study says of its levels."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say

    def lowers(self, sentence: str) -> None:
        """Say it."""
        self._say(sentence)


def finished_names(folder: Path) -> list[str]:
    """Return the names of a study's records that are there."""
    try:
        content = parse_json(read_regular(folder / FOLDER / KEY))
        names = list(content["measurements"])
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [name for name in names if (folder / FOLDER / f"{name}.h5").exists()]


def _measured(listed: experiments.ExperimentList) -> dict[str, str]:
    """Return name -> what decides a record: its measurement, its place in the list, and how long was waited before."""
    keys: dict[str, str] = {}
    waited_s = 0.0
    for step in listed.steps:
        if isinstance(step, Pause):
            waited_s += step.seconds
        elif isinstance(step, Measurement):
            keys[step.name], waited_s = content_hash(step.hash, len(keys), waited_s), 0.0
    return keys


def _older_key(listed: experiments.ExperimentList, bench: Any) -> bytes:
    try:
        return content_hash(listed.hash, bench).encode()
    except (TypeError, ValueError):
        return b""  # a bench that could not be described had no key that held


def _drop_beginnings(place: Path, name: str, record: Record) -> None:
    """Remove what is left of a run that was broken off where the finished record begins with the very same samples."""
    for path in place.glob(f"{escape(name)}.partial*.h5"):
        with suppress(UltraquietError):
            part = files.load(path)
            whole = record.part(0, part.samples)
            if np.array_equal(part.inputs, whole.inputs) and np.array_equal(part.outputs, whole.outputs):
                path.unlink(missing_ok=True)
