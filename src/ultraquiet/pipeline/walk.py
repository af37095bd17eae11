"""The walk: a study from its bench to its report, each stage reused when nothing it depends on has changed."""

import shutil
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from ultraquiet import experiments
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.registry import lookup
from ultraquiet._base.threads import single_threaded
from ultraquiet.bench.from_file import from_file
from ultraquiet.files import archive, read_record, write_bytes
from ultraquiet.pipeline import preflight, study
from ultraquiet.pipeline.cache import Cache
from ultraquiet.pipeline.report.document import report
from ultraquiet.pipeline.stages import Say, Stages
from ultraquiet.pipeline.summary import Summary, summarise, to_json
from ultraquiet.report import write
from ultraquiet.values import Record

PACKAGED_LISTS = ("suite",)
STUDY_FILE = "study.json"


@single_threaded
def walk(settings: study.Study, folder: Path, beside: Path | None = None, say: Say = print) -> Summary:
    """Run a study and return its summary.

    Args:
        settings: the checked study.
        folder: where `summary.json`, `report.html`, `records/`, `models/`, `controllers/` and `code/` go.
        beside: folder of the study file, where its experiment list is sought.
        say: told one line per finished stage.

    Raises:
        UltraquietError: a stage refuses; those before it are kept and reused.
    """
    bench = _bench(settings, beside)
    if settings.records is not None:
        records = _read(settings.records, beside)
        preflight.check(settings, bench, list(records))
        _prepare(settings, folder, beside)
        _keep(records, folder)
        say(f"read: {len(records)} records")
    else:
        listed = experiments.load(_list_of(settings, beside), bench, settings.study.seed)
        preflight.check(settings, bench, [m.name for m in listed.measurements])
        _prepare(settings, folder, beside)
        records = _recorded(listed, bench, settings, folder)
        say(f"recorded: {len(records)} records, {listed.duration_s:.0f} s on the bench")
    result = Stages(settings, Cache(folder), bench, records, say).run()
    summary = summarise(result)
    write_bytes(folder / "summary.json", to_json(summary))
    write(report(result), folder / "report.html")
    return summary


def _read(table: study.RecordsTable, beside: Path | None) -> dict[str, Record]:
    """Return the records of a study's files by the names of these."""
    records: dict[str, Record] = {}
    mapping = None if table.mapping is None else _at(table.mapping, beside)
    for name in table.files:
        path = _at(name, beside)
        if path.stem in records:
            raise InputError(f"study: two files of [records] are called '{path.stem}'; rename one.")
        records[path.stem] = read_record(path, table.rate_hz, table.inputs, table.outputs, mapping)
    first = next(iter(records.values()))
    for name, record in records.items():
        if (record.rate_hz, record.actuators, record.sensors) != (first.rate_hz, first.actuators, first.sensors):
            raise InputError(f"study: '{name}' has other channels or another rate than '{next(iter(records))}'.")
    return records


def _keep(records: Mapping[str, Record], folder: Path) -> None:
    """Leave copies of records that were read in the study's folder, as those of a bench are."""
    place = folder / "records"
    place.mkdir(exist_ok=True)
    for name, record in records.items():
        archive.save(record, place / f"{name}.h5")


def _at(name: str, beside: Path | None) -> Path:
    """Return the path of a file that a study names; what is relative stands beside the study."""
    return Path(name) if beside is None else (beside / name).resolve()


def _recorded(listed: experiments.ExperimentList, bench: Any, settings: study.Study, folder: Path) -> dict[str, Record]:
    """Return the records of this list on this bench, taking up a run that was broken off; else record anew.

    Records say nothing of the bench's settings that a resumed run could compare, so those of another list or bench go
    before the new key is written; records that no study left are never touched.
    """
    place = folder / "records"
    digest, key_file = content_hash(listed.hash, bench).encode(), place / "list.key"
    names = [m.name for m in listed.measurements]
    present = [name for name in names if (place / f"{name}.h5").exists()]
    if present and not key_file.exists():
        raise StorageError(
            f"study: '{place}' holds records that no study left ({present[0]}, ...); choose another --out."
        )
    place.mkdir(exist_ok=True)
    if not (key_file.exists() and key_file.read_bytes() == digest):
        for name in present:
            (place / f"{name}.h5").unlink()
        write_bytes(key_file, digest)
    return experiments.run(listed, place, bench, resume=True, repeat=names)


def _bench(settings: study.Study, beside: Path | None) -> Any:
    """Return the study's bench; one that draws noise starts from the study's seed unless it has its own."""
    table = settings.bench
    if table is None:
        return None
    if table.object is not None:
        return from_file(table.object, beside or Path(), table.settings, settings.study.seed)
    kind = lookup("bench", table.method)
    draws = any(f.name == "seed" for f in fields(kind)) and "seed" not in table.settings
    return table.make("bench", **({"seed": settings.study.seed} if draws else {}))


def _list_of(settings: study.Study, beside: Path | None) -> str:
    name = settings.experiment.list
    if name is None and settings.bench is not None and settings.bench.method == "hexapod":
        return PACKAGED_LISTS[0]
    if name is None:
        raise InputError("study: [experiment] names no 'list'; only the hexapod has one of its own.")
    return name if name in PACKAGED_LISTS or beside is None else str((beside / name).resolve())


def _located(settings: study.Study, beside: Path | None) -> study.Study:
    """Return the study with where its files stand."""
    found: dict[str, Any] = {}
    if settings.records is None:
        found["experiment"] = study.Experiment(list=_list_of(settings, beside))
    else:
        files = [str(_at(name, beside)) for name in settings.records.files]
        mapping = settings.records.mapping and str(_at(settings.records.mapping, beside))
        found["records"] = settings.records.model_copy(update={"files": files, "mapping": mapping})
    if settings.bench is not None and settings.bench.object is not None:
        name, _, attribute = settings.bench.object.rpartition(":")
        found["bench"] = settings.bench.model_copy(update={"object": f"{_at(name, beside)}:{attribute}"})
    return settings.model_copy(update=found)


def _prepare(settings: study.Study, folder: Path, beside: Path | None) -> None:
    """Make the folder and leave the study in it, with where its list stands, so that `report` finds both again."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"study: '{folder}' cannot be made ({error.strerror}); choose another with --out."
        ) from error
    if shutil.disk_usage(folder).free < NEEDED_BYTES:
        raise StorageError(f"study: '{folder}' has less than {NEEDED_BYTES >> 20} MB free; nothing was started.")
    located = _located(settings, beside)
    write_bytes(folder / STUDY_FILE, located.model_dump_json(indent=1).encode())


# Records, loops and models of the packaged study take about 60 MB.
NEEDED_BYTES = 100 << 20
