"""What the catalogue says of one run: read from its record, or from the journal when it left none."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet._base.regular import read_regular
from ultraquiet.experiments import journal
from ultraquiet.experiments.states import ABORTED, DONE, NOT_STARTED
from ultraquiet.files import load_many
from ultraquiet.values import Record

RUNNING = "RUNNING"


@dataclass(frozen=True)
class Entry:
    """One run: what was measured, when, on which bench, by which list, and in which file.

    `file` and `folder` are below the folder that was searched; a run that left no file has none. `status` is DONE,
    ABORTED (broken off; the file holds what there is), NOT STARTED (announced and never begun) or RUNNING. `when` is
    the beginning in UTC, of a foreign record the time of its file. `signal`, `actuators` (counted from one) and `seeds`
    are lists with commas, empty without excitation. `made_by` names what made a record that no list made. `clipped`
    counts readings at the limits of their sensors, `overruns` frames that came too late. `temperature_c` is the last
    one read before the run. `hash` is that of the record's content, `sha256` that of the file.
    """

    file: str
    folder: str
    name: str
    status: str
    when: str
    made_by: str
    bench: str
    bench_settings: str
    list: str
    list_hash: str
    signal: str
    actuators: str
    seeds: str
    disturbance: str
    controller: str
    rate_hz: float
    samples: int
    clipped: int
    overruns: int
    temperature_c: float | None
    comment: str
    hash: str
    sha256: str


def of_file(place: Path, file: str) -> Entry | None:
    """Return the entry of a file, or None when it holds no single record."""
    path = place / file
    try:
        values = list(load_many(path).values())
        sha256, changed = hashlib.sha256(read_regular(path)).hexdigest(), path.stat().st_mtime
    except (StorageError, OSError):
        return None
    if len(values) != 1 or not isinstance(values[0], Record):
        return None
    record, provenance = values[0], values[0].provenance
    conditions = _table(provenance.settings.get("conditions"))
    bench = _table(provenance.settings.get("bench"))
    measured = _table(provenance.settings.get("measurement"))
    # Of a foreign record nothing but the file's own time is known.
    written = datetime.fromtimestamp(changed, UTC).isoformat(timespec="milliseconds")
    return Entry(
        file=file,
        folder=Path(file).parent.as_posix(),
        status=ABORTED if "partial" in provenance.settings else DONE,
        when=str(conditions.get("begun", written)),
        made_by=provenance.made_by,
        list=str(provenance.settings.get("list", "")),
        list_hash=provenance.parents[0] if provenance.parents and measured else "",
        rate_hz=record.rate_hz,
        clipped=sum(record.clipped()),
        overruns=int(bench.get("overruns", 0)),
        temperature_c=conditions.get("temperature_c"),
        comment=str(conditions.get("comment", "")),
        hash=record.hash,
        sha256=sha256,
        **_measurement({"name": Path(file).stem, **measured, "samples": record.samples}),
        **_bench(bench),
    )


def of_journal(place: Path, path: Path, filed: Iterable[Entry]) -> Iterator[Entry]:
    """Yield the runs a journal knows of and no file of `filed` holds: never begun, broken off early, or lost."""
    try:
        events = journal.entries(path.parent)
    except StorageError:
        return  # what a damaged journal would say is not known; the records speak for themselves
    folder = path.parent.relative_to(place).as_posix()
    filed = list(filed)
    filed_here = {e.name for e in filed if e.folder == folder}
    hashes = {e.hash for e in filed}
    announced, last = _announced(events), events[-1] if events else {}
    at_work = last.get("event") == "begun" and journal.busy(path.parent)
    for name, (status, event) in _ends(events).items():
        planned, heading = announced.get(name, ({"name": name}, {}))
        running = at_work and last["name"] == name
        # A record that was moved elsewhere below the folder is found there.
        if not running and (name in filed_here or event.get("record") in hashes):
            continue
        log = f"{folder}/{name}.log".removeprefix("./") if (path.parent / f"{name}.log").exists() else ""
        yield _without_record(RUNNING if running else status, event, planned, heading, folder, log)


def _without_record(
    status: str, event: Mapping[str, Any], planned: Mapping[str, Any], heading: Mapping[str, Any], folder: str, log: str
) -> Entry:
    return Entry(
        file=log,
        folder=folder,
        status=status,
        when=str(event.get("at", "")),
        made_by="experiment",
        list=str(heading.get("list", "")),
        list_hash=str(heading.get("list_hash", "")),
        rate_hz=float(heading.get("rate_hz", 0.0)),
        clipped=0,
        overruns=int(event.get("overruns", 0)),
        temperature_c=None,
        comment=str(planned.get("comment", "")),
        hash=str(event.get("record", "")),
        sha256="",
        **_measurement(planned),
        **_bench(_table(heading.get("bench"))),
    )


def _announced(events: Iterable[Mapping[str, Any]]) -> dict[str, tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Return name -> what was announced of a measurement, and of its list; the latest announcement counts."""
    return {m["name"]: (m, e) for e in events if e["event"] == "planned" for m in e["measurements"]}


def _ends(events: Iterable[Mapping[str, Any]]) -> dict[str, tuple[str, Mapping[str, Any]]]:
    """Return name -> how far a measurement came, and the event that says so."""
    ends: dict[str, tuple[str, Mapping[str, Any]]] = {}
    for event in events:
        if event["event"] == "planned":
            for measurement in event["measurements"]:
                ends.setdefault(measurement["name"], (NOT_STARTED, {}))
        elif event["event"] in ("begun", "aborted"):
            ends[event["name"]] = (ABORTED, event)
        elif event["event"] == "finished":
            ends[event["name"]] = (DONE, event)
    return ends


def _measurement(description: Mapping[str, Any]) -> dict[str, Any]:
    drives = description.get("excitation", [])
    return {
        "name": str(description.get("name", "")),
        "signal": ",".join(sorted({str(d["method"]) for d in drives})),
        "actuators": ",".join(str(d["actuator"]) for d in drives),
        "seeds": ",".join(str(d["seed"]) for d in drives),
        "disturbance": ",".join(sorted({str(d["method"]) for d in description.get("disturbance", [])})),
        "controller": str(description.get("controller", "")),
        "samples": int(description.get("samples", 0)),
    }


def _bench(description: Mapping[str, Any]) -> dict[str, Any]:
    settings = {key: value for key, value in description.items() if key != "made_by"}
    return {
        "bench": str(description.get("made_by", "")).removeprefix("bench."),
        "bench_settings": json.dumps(settings, sort_keys=True, default=str) if settings else "",
    }


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
