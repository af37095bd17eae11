"""The folder of records before a list runs: what is there, what may not be touched, and whether the rest fits."""

import os
import shutil
from collections.abc import Collection
from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.experiments import journal
from ultraquiet.experiments.listed import ExperimentList
from ultraquiet.experiments.measure import path_of
from ultraquiet.experiments.plan import Measurement
from ultraquiet.files import load as load_value
from ultraquiet.files import reason
from ultraquiet.values import Record

SAMPLE_BYTES = 8  # float64, as archives and logs hold it
RECORD_BYTES = 65536  # what channels, provenance and HDF5's own tables take beside the samples, generously


def prepared(folder: Path) -> Path:
    """Return the folder, made when it was absent."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"experiment: the folder '{folder}' cannot be made ({reason(error)}).") from error
    return folder


def finished_in(listed: ExperimentList, place: Path, resume: bool, overwrite: bool) -> dict[str, Record]:
    """Return the records that need not be measured; refuse when others would be written over."""
    present = [m for m in listed.measurements if os.path.lexists(path_of(place, m.name))]
    if resume:
        return {m.name: _same(m, path_of(place, m.name)) for m in present}
    if present and not overwrite:
        names = ", ".join(m.name for m in present[:5]) + (", ..." if len(present) > 5 else "")
        raise StorageError(
            f"experiment: '{place}' holds {len(present)} of the records already ({names}); resume (--resume), ask to "
            f"overwrite (--overwrite), or choose another folder (--out)."
        )
    return {}


def refuse_repetition(
    listed: ExperimentList, place: Path, finished: Collection[str], resume: bool, repeat: Collection[str]
) -> None:
    """Refuse to excite again what the journal says was begun already, unless it is named."""
    listed_names = {m.name for m in listed.measurements}
    unknown = sorted(set(repeat) - listed_names)
    if unknown:
        raise InputError(f"experiment: the list has no measurement '{unknown[0]}' to repeat.")
    again = [name for name in journal.begun(place) if name in listed_names - set(finished) - set(repeat)]
    if again:
        how = "name them in 'repeat' (--repeat)" if resume else "resume and name them in 'repeat' (--repeat)"
        raise StorageError(
            f"experiment: {', '.join(again)} in '{place}' was begun before and left no record; to excite again, {how}."
        )


def _same(measurement: Measurement, path: Path) -> Record:
    remedy = "move it away or choose another folder"
    try:
        record = load_value(path)
    except StorageError as error:
        raise StorageError(f"experiment: {str(error).removeprefix('archive: ').rstrip('.')}; {remedy}.") from error
    measurement_hash = record.provenance.settings.get("measurement_hash") if isinstance(record, Record) else None
    if not isinstance(record, Record) or measurement_hash != measurement.hash:
        raise InputError(
            f"experiment: '{path}' was not made by '{measurement.name}' as the list has it now (line "
            f"{measurement.line}); {remedy}."
        )
    return record


def sweep(place: Path) -> None:
    """Remove half-written files of a process that was killed; the journal's lock says that no other is at work."""
    for part in (*place.glob(".*.h5.*.part"), *place.glob(".*.log.*.part")):
        part.unlink(missing_ok=True)


def needed_bytes(listed: ExperimentList, finished: Collection[str] = ()) -> int:
    """Return what the records still to be measured take on the disk at most, in bytes.

    The last one stands there twice for a moment, as the log it was written to and as the record made from it.
    """
    bench = listed.bench
    channels = 0 if bench is None else len(bench.actuators) + len(bench.sensors)
    todo = [m.samples for m in listed.measurements if m.name not in finished]
    return (sum(todo) + max(todo, default=0)) * channels * SAMPLE_BYTES + len(todo) * RECORD_BYTES


def check_space(listed: ExperimentList, place: Path, finished: Collection[str]) -> None:
    """Refuse to begin what would not fit."""
    needed, free = needed_bytes(listed, finished), shutil.disk_usage(place).free
    if free < needed:
        raise StorageError(
            f"experiment: the records need {needed / 1e6:.1f} MB, '{place}' has {free / 1e6:.1f} MB free; "
            "nothing was executed."
        )
