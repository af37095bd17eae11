"""Models of a bench's further units, from the signals that the study's own unit was recorded with."""

from collections.abc import Mapping
from typing import Any

from ultraquiet._base.progress import task
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import PlantFacts
from ultraquiet.pipeline.identification import grouped, plant
from ultraquiet.pipeline.preflight import as_unit
from ultraquiet.pipeline.study import Plant
from ultraquiet.values import Record, StateSpace


def further(bench: Any, unit: str, records: Mapping[str, Record], settings: Plant) -> Outcome[PlantFacts]:
    """Record the groups that the plant is identified from on another unit, and identify it likewise.

    Args:
        bench: as the study has it.
        unit: another one.
        records: of the study's own unit; their inputs are what is sent.
        settings: `[plant]`.
    """
    other, groups = as_unit(bench, unit), grouped(records)
    names = [name for asked in settings.records for name in groups.get(asked, [asked])]
    again: dict[str, Record] = {}
    with task(f"record {unit}", len(names)) as progress:
        for name in names:
            again[name] = other.run(records[name].inputs)
            progress.advance(note=name)
    found = plant(again, settings)
    return Outcome(found.facts, {of_unit(unit): found.values[stored.PLANT]})


def of_unit(unit: str) -> str:
    """Return the name under which the model of a further unit is kept."""
    return f"{stored.PLANT}-{unit}"


def for_method(method: Any, first: StateSpace, others: Mapping[str, Outcome[PlantFacts]]) -> Any:
    """Return what a design is given: all plants where it takes several, else the first."""
    if not others or not getattr(method, "several_plants", False):
        return first
    return [first, *(outcome.values[of_unit(unit)] for unit, outcome in others.items())]
