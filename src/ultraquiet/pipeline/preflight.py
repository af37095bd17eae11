"""What a study asks of its bench and of its experiment list, checked before anything moves."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet.experiments import ExperimentList
from ultraquiet.pipeline.study import Study, listed


def check(study: Study, bench: Any, experiment: ExperimentList) -> None:
    """Refuse units and tones that the bench does not have, and records that the experiment does not leave.

    Raises:
        InputError: every mistake, in one message.
    """
    mistakes = [*_closed_loop(study, bench), *_records(study, experiment)]
    if mistakes:
        raise InputError(listed("study", mistakes))


def as_unit(bench: Any, unit: str) -> Any:
    """Return the bench as another unit of its kind; a bench that knows no units stands for itself."""
    if is_dataclass(bench) and not isinstance(bench, type) and any(f.name == "unit" for f in fields(bench)):
        return replace(bench, unit=unit)
    return bench


def _closed_loop(study: Study, bench: Any) -> Iterator[str]:
    for unit in study.closed_loop.units:
        try:
            as_unit(bench, unit)
        except UltraquietError as error:
            yield f"closed_loop.units: {error}"
    for f in study.closed_loop.tones_hz:
        if f >= bench.rate_hz / 2:
            yield f"closed_loop.tones_hz: {f:g} Hz is not below half the bench's rate, {bench.rate_hz / 2:g} Hz."


def _records(study: Study, experiment: ExperimentList) -> Iterator[str]:
    names = [m.name for m in experiment.measurements]
    known = dict.fromkeys([*names, *(name.rpartition("-")[0] for name in names)])
    asked = [
        ("identify.records", study.identify.records),
        ("identify.held_out", study.identify.held_out),
        *(("identify.paper_records", name) for name in study.identify.paper_records),
        *(("plant.records", name) for name in study.plant.records),
    ]
    for where, name in asked:
        if name not in known:
            yield f"{where}: there are no records '{name}'; the experiment leaves {', '.join(experiment.groups)}."
