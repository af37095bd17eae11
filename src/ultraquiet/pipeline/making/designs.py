"""Stages that a process beside the walk makes as well: what each depends on, and how it is made."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from ultraquiet._base.registry import lookup
from ultraquiet._base.tables import Method
from ultraquiet.pipeline import control, identification
from ultraquiet.pipeline.facts.loops import DesignFacts
from ultraquiet.pipeline.facts.models import IdentificationFacts
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.study import Design, Plant, Study
from ultraquiet.pipeline.tables.around import inside
from ultraquiet.values import Record, StateSpace


def identify_key(record_hashes: Mapping[str, str], study: Study) -> list[Any]:
    """Return what the stage `identify` depends on: all records by their hashes, and what is fitted to them."""
    return [dict(record_hashes), study.identify, study.paper]


def identify_stage(cache: Cache, study: Study, records: Mapping[str, Record]) -> Outcome[IdentificationFacts]:
    """Identify channel by channel."""
    key = identify_key({name: record.hash for name, record in records.items()}, study)
    compute = partial(identification.identified, records, study.identify, study.paper)
    return cache.stage("identify", "models", key, compute, IdentificationFacts)


def plant_key(record_hashes: Mapping[str, str], settings: Plant) -> list[Any]:
    """Return what the stage `plant` depends on: all records by their hashes, and `[plant]` but its units."""
    return [dict(record_hashes), settings.model_dump(exclude={"units"})]


def design_key(
    plant: StateSpace,
    settings: Design,
    loop: LoopPlan,
    others: Mapping[str, StateSpace],
    around: StateSpace | None = None,
) -> list[Any]:
    """Return what the stage `design-NAME` depends on.

    Plants that it takes, the table, what a reduction is held to, and the law inside, where there is one.
    """
    promised = settings.reduce and [key_of(settings.reduce), loop.band_hz, loop.tones_hz]
    further = [{unit: model.hash for unit, model in others.items()}] if others and takes_several(settings) else []
    within = [] if settings.around is None else [settings.around, around and around.hash]
    return [plant.hash, key_of(settings.design), promised, *further, *within]


def design_stage(
    cache: Cache,
    name: str,
    settings: Design,
    plant: StateSpace,
    plan: LoopPlan,
    others: Mapping[str, StateSpace],
    around: StateSpace | None = None,
) -> Outcome[DesignFacts]:
    """Design and reduce one controller.

    Args:
        cache: of the study.
        name: of the controller.
        settings: its table.
        plant: G.
        plan: what is measured of the loop.
        others: models of further units, for designs that hold on several.
        around: the law inside, where the table names one.
    """
    key = design_key(plant, settings, plan, others, around)
    compute = partial(control.designed, name, plant, settings, plan, others, around)
    return cache.stage(f"design-{name}", "controllers", key, compute, DesignFacts)


def by_need(study: Study) -> list[str]:
    """Return the names of a study's controllers, the one of which something is required among the first two.

    What is required takes the longest to design, mostly, and to measure. Before it there is one other law, whose loop
    is measured meanwhile; after it come those that are sought with a given peak, which take longer than others: what is
    begun last is alone on a processor. A law that is put round another comes after that.
    """
    asked, controllers = study.requirements, study.controllers
    first, *others = sorted(controllers, key=lambda name: asked is None or name != asked.law)
    before, after = (others[:1], others[1:]) if asked is not None else ([], others)
    ordered: list[str] = []
    for name in [*before, first, *sorted(after, key=lambda name: "peak_db" not in controllers[name].design.settings)]:
        ordered += [each for each in reversed(inside(controllers, name)) if each not in ordered]
    return ordered


def chains(study: Study) -> list[list[str]]:
    """Return the names of `by_need`, laws that stand round one another together, the innermost first."""
    found: dict[str, list[str]] = {}
    for name in by_need(study):
        found.setdefault(inside(study.controllers, name)[-1], []).append(name)
    return list(found.values())


def takes_several(settings: Design) -> bool:
    """Return whether a design holds on several plants at once."""
    return getattr(lookup("design", settings.design.method), "several_plants", False)


def key_of(method: Method) -> dict[str, Any]:
    """Return all that a method's table says; its settings are not declared fields and must be asked for."""
    return method.model_dump()
