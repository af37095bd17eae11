"""The study as far as its bench goes, and models of the bench's further units, for laws that hold on several."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet.pipeline import Study
from ultraquiet.pipeline.further_units import further_plants
from ultraquiet.pipeline.identification import of_unit
from ultraquiet.pipeline.stage import Cache
from ultraquiet.values import Record, StateSpace
from ultraquiet.workbench.engine.making.laws import design_table
from ultraquiet.workbench.engine.making.models import plant_table
from ultraquiet.workbench.engine.steps import State


def study_of(state: Mapping[str, Any]) -> Study:
    """Return the study of the boards as far as its bench and list go; models and laws may still be missing.

    Raises:
        InputError: it has no bench.
    """
    tables = state["tables"]
    if "bench" not in tables:
        raise InputError("bench: the study has none; choose one on the page Bench.")
    model, laws = state["model"], state["laws"]
    # a study wants a plant and a law, which do not change what is measured for them
    plant = plant_table(state["models"][model]) if model else {"method": "rational", "records": ["later"]}
    designs = {name: design_table(recipe) for name, recipe in laws.items()} or {"later": {"design": {"method": "lqg"}}}
    kept = {name: tables[name] for name in ("bench", "experiment", "blending", "closed_loop") if name in tables}
    head = {"title": state["title"], **tables.get("study", {})}
    return Study.model_validate({"study": head, **kept, "plant": plant, "controllers": designs})


def of_units(
    folder: Path, state: State, recipe: Mapping[str, Any], records: Mapping[str, Record], stages: Cache | None = None
) -> dict[str, StateSpace]:
    """Return models of the further units that a recipe names, by the names under which they are kept.

    Raises:
        InputError: the study has no bench, or its bench knows no such unit.
    """
    if not recipe.get("units"):
        return {}
    settings = study_of({**state, "model": None})
    asked = settings.plant.model_validate(plant_table(recipe))
    found = further_plants(settings.model_copy(update={"plant": asked}), records, folder, stages)
    return {of_unit(unit): model for unit, model in found.items()}
