"""What a study asks of its bench and of its experiment list, checked before anything moves."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet.experiments import ExperimentList
from ultraquiet.pipeline.study import Study, StudyError


def check(study: Study, bench: Any, experiment: ExperimentList) -> None:
    """Refuse units and tones that the bench does not have, and records that the experiment does not leave.

    Raises:
        StudyError: every mistake, in one message.
    """
    mistakes = study.mistakes()
    _closed_loop(study, bench, mistakes)
    _records(study, experiment, mistakes)
    mistakes.refuse(StudyError, "study")


def as_unit(bench: Any, unit: str) -> Any:
    """Return the bench as another unit of its kind; a bench that knows no units stands for itself."""
    if is_dataclass(bench) and not isinstance(bench, type) and any(f.name == "unit" for f in fields(bench)):
        return replace(bench, unit=unit)
    return bench


def _closed_loop(study: Study, bench: Any, mistakes: Mistakes) -> None:
    for k, unit in enumerate(study.closed_loop.units):
        try:
            as_unit(bench, unit)
        except UltraquietError as error:
            mistakes.add(("closed_loop", "units", k), f"closed_loop.units: {error}")
    for k, f in enumerate(study.closed_loop.tones_hz):
        if f >= bench.rate_hz / 2:
            fault = f"{f:g} Hz is not below half the bench's rate, {bench.rate_hz / 2:g} Hz."
            mistakes.add(("closed_loop", "tones_hz", k), f"closed_loop.tones_hz: {fault}")


def _records(study: Study, experiment: ExperimentList, mistakes: Mistakes) -> None:
    names = [m.name for m in experiment.measurements]
    known = dict.fromkeys([*names, *(name.rpartition("-")[0] for name in names)])
    asked: list[tuple[Place, str]] = [
        (("identify", "records"), study.identify.records),
        (("identify", "held_out"), study.identify.held_out),
        *((("identify", "paper_records", k), name) for k, name in enumerate(study.identify.paper_records)),
        *((("plant", "records", k), name) for k, name in enumerate(study.plant.records)),
    ]
    for place, name in asked:
        if name not in known:
            fault = f"there are no records '{name}'; the experiment leaves {', '.join(experiment.groups)}."
            mistakes.add(place, f"{place[0]}.{place[1]}: {fault}")
