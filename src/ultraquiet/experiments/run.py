"""Execute a checked list on a bench: one HDF5 record per measurement, none of them ever written over unasked."""

import os
import shutil
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.progress import task
from ultraquiet.experiments import journal
from ultraquiet.experiments.listed import NO_BENCH, ExperimentList
from ultraquiet.experiments.measure import Watch, measure, path_of
from ultraquiet.experiments.mistakes import ListError
from ultraquiet.experiments.plan import Measurement, Pause
from ultraquiet.files import load as load_value
from ultraquiet.files import reason
from ultraquiet.values import Record

SAMPLE_BYTES = 8  # float64, as archives hold it
RECORD_BYTES = 65536  # what channels, provenance and HDF5's own tables take beside the samples, generously


def run(
    experiment_list: ExperimentList,
    folder: str | os.PathLike[str],
    bench: Any | None = None,
    *,
    resume: bool = False,
    repeat: Collection[str] = (),
    overwrite: bool = False,
    sleep: Callable[[float], None] = time.sleep,
) -> dict[str, Record]:
    r"""Execute a list in order; each measurement leaves `folder/NAME.h5` before the next one begins.

    Args:
        experiment_list: what `load` or `parse` returned.
        folder: where the records go; made when absent.
        bench: used instead of the one the list names.
        resume: go on where a run was broken off: finished records of this very list are taken from the folder.
        repeat: names of measurements that were begun before, left no record, and shall be excited once more.
        overwrite: write over records that stand in the folder.
        sleep: how to spend a pause in seconds, for benches whose time is not the wall's.

    Returns:
        Name -> record, in the order of the list.

    Raises:
        InputError: no bench, or mistakes that show only on this bench; nothing has moved then.
        StorageError: records would be written over, an excitation would be repeated unasked, the disk is full, the
            folder is closed; finished records stay.

    >>> import tempfile
    >>> from ultraquiet.experiments import parse
    >>> from ultraquiet.bench import Wrapped
    >>> listed = parse('[[commands]]\ndo = "excite"\nname = "push"\nsamples = 300\nsignal = { method = "step" }')
    >>> bench = Wrapped(lambda u, d: 2.0 * u, lambda: None, 3500.0, ["force"], ["speed"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     records = run(listed, folder, bench)
    >>> {name: float(record.outputs.max()) for name, record in records.items()}
    {'push-1': 20.0}
    """
    listed = experiment_list if bench is None else experiment_list.on(bench)
    if listed.bench is None:
        raise ListError(listed.name, [(1, NO_BENCH)])
    place = _prepared(Path(folder))
    with journal.opened(place) as log:
        finished = _finished(listed, place, resume, overwrite)
        if not overwrite:
            _refuse_repetition(listed, place, finished, resume, repeat)
        _sweep(place)
        _check_space(listed, place, finished)
        return _executed(listed, place, finished, log, overwrite, sleep)


def _executed(
    listed: ExperimentList,
    place: Path,
    finished: dict[str, Record],
    log: journal.Journal,
    overwrite: bool,
    sleep: Callable[[float], None],
) -> dict[str, Record]:
    records: dict[str, Record] = {}
    todo = len(listed.measurements) - len(finished)
    with task(listed.title or listed.name, len(listed.measurements)) as progress:
        for step in listed.steps:
            if isinstance(step, Pause):
                # Nothing needs to come to rest when nothing further will be measured.
                if todo:
                    sleep(step.seconds)
                continue
            record = finished.get(step.name)
            if record is None:
                log.write("begun", name=step.name, hash=step.hash)
                record = measure(listed, step, len(records), place, overwrite, Watch()).record
                log.write("finished", name=step.name, hash=step.hash, record=record.hash)
                todo -= 1
            records[step.name] = record
            progress.advance(note=step.name)
    return records


def _prepared(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"experiment: the folder '{folder}' cannot be made ({reason(error)}).") from error
    return folder


def _finished(listed: ExperimentList, place: Path, resume: bool, overwrite: bool) -> dict[str, Record]:
    """Return the records that need not be measured; refuse when others would be written over."""
    there = [m for m in listed.measurements if os.path.lexists(path_of(place, m.name))]
    if resume:
        return {m.name: _same(m, path_of(place, m.name)) for m in there}
    if there and not overwrite:
        names = ", ".join(m.name for m in there[:5]) + (", ..." if len(there) > 5 else "")
        raise StorageError(
            f"experiment: '{place}' holds {len(there)} of the records already ({names}); resume, ask to overwrite, or "
            "choose another folder."
        )
    return {}


def _refuse_repetition(
    listed: ExperimentList, place: Path, finished: dict[str, Record], resume: bool, repeat: Collection[str]
) -> None:
    """Refuse to excite again what the journal says was begun already, unless it is named."""
    asked = {m.name for m in listed.measurements}
    unknown = sorted(set(repeat) - asked)
    if unknown:
        raise InputError(f"experiment: the list has no measurement '{unknown[0]}' to repeat.")
    again = [name for name in journal.begun(place) if name in asked - set(finished) - set(repeat)]
    if again:
        how = "name them in 'repeat' (--repeat)" if resume else "resume and name them in 'repeat' (--repeat)"
        raise StorageError(
            f"experiment: {', '.join(again)} in '{place}' was begun before and left no record; to excite again, {how}."
        )


def _same(measurement: Measurement, path: Path) -> Record:
    record = load_value(path)
    made = record.provenance.settings.get("measurement_hash") if isinstance(record, Record) else None
    if made != measurement.hash:
        raise InputError(
            f"experiment: '{path}' was not made by '{measurement.name}' as the list has it now (line "
            f"{measurement.line}); move it away or choose another folder."
        )
    return record


def _sweep(place: Path) -> None:
    # Half-written files of a process that was killed; the journal's lock says that no other is at work here.
    for part in place.glob(".*.h5.*.part"):
        part.unlink(missing_ok=True)


def _check_space(listed: ExperimentList, place: Path, finished: dict[str, Record]) -> None:
    bench = listed.bench
    assert bench is not None
    channels = len(bench.actuators) + len(bench.sensors)
    todo = [m.samples for m in listed.measurements if m.name not in finished]
    needed = sum(todo) * channels * SAMPLE_BYTES + len(todo) * RECORD_BYTES
    free = shutil.disk_usage(place).free
    if free < needed:
        raise StorageError(
            f"experiment: the records need {needed / 1e6:.1f} MB, '{place}' has {free / 1e6:.1f} MB free; "
            "nothing was executed."
        )
