"""One measurement: its signals to the bench, its blocks as they come, and the record that is left of it."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.experiments.listed import ExperimentList
from ultraquiet.experiments.plan import Measurement, volts
from ultraquiet.files import save
from ultraquiet.values import Record


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
    return folder / f"{name}.h5"


def partial_path_of(folder: Path, name: str) -> Path:
    """Return the file of what is left of a measurement that was broken off."""
    return folder / f"{name}.partial.h5"


def measure(
    listed: ExperimentList, step: Measurement, index: int, place: Path, overwrite: bool, watch: Watch
) -> Measured:
    """Run one measurement of a list and leave its record in the folder `place`.

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
        StorageError: the record cannot be written.
    """
    record = _recorded(listed, step, index, watch)
    path = path_of(place, step.name)
    try:
        save(record, path, overwrite)
    except StorageError as error:
        said = str(error).rstrip(".").removeprefix("files: ")
        raise StorageError(
            f"experiment stopped at '{step.name}', {index} records are finished and safe: {said}."
        ) from error
    return Measured(record, path)


def _recorded(listed: ExperimentList, step: Measurement, index: int, watch: Watch) -> Record:
    bench = listed.bench
    assert bench is not None
    count, rate_hz = len(bench.actuators), bench.rate_hz
    actuation = volts(step.drives, count, step.samples, rate_hz)
    disturbance = volts(step.disturbances, count, step.samples, rate_hz) if step.disturbances else None
    # A bench that numbers its draws gets the place in the list, so that a resumed list repeats none of them.
    numbered = {"run_index": index} if "run_index" in inspect.signature(bench.run).parameters else {}
    record: Record = bench.run(actuation, disturbance=disturbance, controller=step.controller, **numbered)
    settings = _settings(listed, step, record, watch)
    made = Provenance("experiment", settings, record.provenance.seed, (listed.hash,), versions())
    return Record(record.inputs, record.outputs, record.rate_hz, record.actuators, record.sensors, made)


def _settings(listed: ExperimentList, step: Measurement, record: Record, watch: Watch) -> dict[str, Any]:
    settings = {
        "list": listed.title or listed.name,
        "measurement": step.describe(),
        "measurement_hash": step.hash,
        "bench": {"made_by": record.provenance.made_by, **record.provenance.settings},
    }
    return settings | ({"conditions": dict(watch.conditions)} if watch.conditions else {})
