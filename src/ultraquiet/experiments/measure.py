"""One measurement: its signals to the bench, its blocks to a log as they come, and the record that is left of it."""

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.bench import Block, Streaming, Tally
from ultraquiet.experiments import journal
from ultraquiet.experiments.listed import ExperimentList
from ultraquiet.experiments.plan import Measurement, sent
from ultraquiet.files import LogWriter, finalise, log_header, read_log
from ultraquiet.files.names import inside
from ultraquiet.values import Record
from ultraquiet.values.channel import at_limits


def _never() -> bool:
    return False


def _nobody(block: Any) -> None:
    del block


@dataclass(frozen=True)
class Watch:
    """Who looks on while a measurement runs, and may end it.

    `stop` is asked before each block; once it says yes the bench ramps to zero. `block` is told every block as soon as
    it is measured. `conditions` go into the record's provenance (the last temperatures read, for instance).
    """

    stop: Callable[[], bool] = _never
    block: Callable[[Any], None] = _nobody
    conditions: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Measured:
    """What a measurement left: the record, its file, whether it was broken off, and how many frames came too late."""

    record: Record
    path: Path
    aborted: bool = False
    overruns: int = 0


def path_of(folder: Path, name: str) -> Path:
    """Return the file of a record."""
    return inside("experiment", folder, f"{name}.h5")


def log_path_of(folder: Path, name: str) -> Path:
    """Return the file a measurement writes to while it runs."""
    return inside("experiment", folder, f"{name}.log")


def partial_path_of(folder: Path, name: str, attempt: int = 1) -> Path:
    """Return the file of what is left of a measurement that was broken off, for the n-th time."""
    return inside("experiment", folder, f"{name}.partial.h5" if attempt == 1 else f"{name}.partial-{attempt}.h5")


def measure(
    listed: ExperimentList, step: Measurement, index: int, place: Path, overwrite: bool, watch: Watch
) -> Measured:
    """Run one measurement of a list and leave its record in the folder `place`.

    Every block stands in `NAME.log` as soon as it is measured. A process that dies leaves that file; `recover` makes
    a record of it.

    Args:
        listed: the list, planned for its bench.
        step: which of its measurements.
        index: how many records come before it in the list.
        place: the folder of records; it exists.
        overwrite: write over a record of that name.
        watch: who looks on.

    Returns:
        What was measured: of a whole run in `NAME.h5`, of one broken off in `NAME.partial.h5`.

    Raises:
        StorageError: the record cannot be written; the blocks before are safe.
        InputError: the bench handed over nothing, or what is no number.
    """
    try:
        return _Run(listed, step, index, watch).to_record(place, overwrite)
    except StorageError as error:
        cause = str(error).rstrip(".").removeprefix("files: ")
        raise StorageError(
            f"experiment stopped at '{step.name}', {index} records are finished and safe: {cause}."
        ) from error


def recover(place: Path) -> dict[str, Path]:
    """Make records of the logs that a process left behind when it died; return name -> record.

    A log that is complete becomes `NAME.h5`, any other `NAME.partial.h5`, whose provenance says how much there is of
    how much, and why. A log without samples is removed.

    Raises:
        StorageError: the header of a log is damaged, a name or link leads out of the folder, or the disk refuses; the
            log is still there then.
    """
    records: dict[str, Path] = {}
    # Only logs of measurements that were begun here: others' files may have that suffix too.
    for path in (log_path_of(place, name) for name in journal.begun(place)):
        if not path.exists():
            continue
        try:
            log = read_log(path)
        except StorageError as error:
            cause = str(error).rstrip(".")
            raise StorageError(f"{cause}; move it out of the folder to go on, nothing was executed.") from error
        if log.complete:
            records[path.stem] = path_of(place, path.stem)
            finalise(path, records[path.stem], bool(log.header.get("overwrite")))
        elif log.samples.shape[1]:
            records[path.stem] = _partial(path, place)[1]
        else:
            path.unlink()
    return records


def _partial(log: Path, place: Path) -> tuple[Record, Path]:
    """Make a partial record of a log, beside those of earlier attempts."""
    for attempt in count(1):
        path = partial_path_of(place, log.stem, attempt)
        occupied = os.path.lexists(path)
        try:
            return finalise(log, path), path
        except StorageError:
            # Taken by an earlier attempt; what is taken by this very record is accepted by `finalise`.
            if not occupied:
                raise
    raise AssertionError


class _Run:
    """One run of the bench, on its way to the disk."""

    def __init__(self, listed: ExperimentList, step: Measurement, index: int, watch: Watch) -> None:
        bench = listed.bench
        assert bench is not None
        self._bench, self._step, self._watch = bench, step, watch
        self._stopped = False
        self._tally = Tally()
        streams = isinstance(bench, Streaming)
        # A bench that numbers its draws gets the place in the list, so that a resumed list repeats none of them.
        numbered = {"run_index": index} if streams or "run_index" in inspect.signature(bench.run).parameters else {}
        actuation, disturbance = _signals(bench, step)
        if isinstance(bench, Streaming):
            self._blocks: Iterable[Block] = bench.stream(
                actuation, disturbance, step.controller, run_index=index, stop=self._stop
            )
            source = bench.provenance
        else:
            record: Record = bench.run(actuation, disturbance=disturbance, controller=step.controller, **numbered)
            self._blocks = (_block(record),)
            source = record.provenance
        settings: dict[str, Any] = {
            "list": listed.title or listed.name,
            "measurement": step.describe(),
            "measurement_hash": step.hash,
            "bench": {"made_by": source.made_by, **source.settings, **numbered},
        }
        settings |= {"conditions": dict(watch.conditions)} if watch.conditions else {}
        self._provenance = Provenance("experiment", settings, source.seed, (listed.hash,), versions())

    def to_record(self, place: Path, overwrite: bool) -> Measured:
        """Write the blocks down as they come, and make the record when the last one has come."""
        bench, step, path = self._bench, self._step, log_path_of(place, self._step.name)
        header = log_header(bench.actuators, bench.sensors, bench.rate_hz, step.samples, self._provenance)
        with LogWriter(path, {**header, "overwrite": overwrite}) as log:
            try:
                for block in self._blocks:
                    log.append(np.vstack([block.command, self._readings(block, log.samples)]))
                    self._tally.take(block)
                    self._watch.block(block)
            finally:
                # Whatever went wrong, the actuators come to zero first; a generator does so when it is closed.
                getattr(self._blocks, "close", lambda: None)()
            samples = log.samples
            why = self._incomplete(samples)
            log.close(complete=not why, reason=why, notes=self._notes())
        if not samples:
            path.unlink()
            raise InputError(f"experiment: the bench handed over no samples of '{step.name}'.")
        if why:
            record, partial_path = _partial(path, place)
            return Measured(record, partial_path, True, self._tally.overruns)
        record = finalise(path, path_of(place, step.name), overwrite)
        return Measured(record, path_of(place, step.name), False, self._tally.overruns)

    def _stop(self) -> bool:
        self._stopped = self._stopped or self._watch.stop()
        return self._stopped

    def _readings(self, block: Block, before: int) -> FloatArray:
        if not np.isfinite(block.readings).all():
            raise InputError(
                f"experiment stopped at '{self._step.name}': after sample {before} the bench handed over readings that "
                "are no finite numbers; what was measured before is kept."
            )
        return block.readings

    def _notes(self) -> dict[str, Any]:
        return {"bench": self._tally.counts()} if isinstance(self._bench, Streaming) else {}

    def _incomplete(self, samples: int) -> str:
        if self._stopped:
            return f"it was stopped after {samples} of {self._step.samples} samples"
        if samples != self._step.samples:
            return f"the bench handed over {samples} of {self._step.samples} samples"
        return ""


def _signals(bench: Any, step: Measurement) -> tuple[FloatArray, FloatArray | None]:
    channels, rate_hz = len(bench.actuators), bench.rate_hz
    actuation = sent(step.drives, channels, step.samples, rate_hz)
    disturbance = sent(step.disturbances, channels, step.samples, rate_hz) if step.disturbances else None
    return actuation, disturbance


def _block(record: Record) -> Block:
    """Return the whole run of a bench that does not stream."""
    limited = (at_limits(record.inputs, record.actuators), at_limits(record.outputs, record.sensors))
    return Block(record.inputs, record.outputs, *limited)
