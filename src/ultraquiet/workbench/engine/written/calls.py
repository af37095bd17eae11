"""What a recorded script calls for steps that are more than one call of a room."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ultraquiet.files import parse_mapping, read_record
from ultraquiet.pipeline import control, identification
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.further_units import further_plants
from ultraquiet.pipeline.study import ClosedLoop, Deploy, Design, Plant, Study
from ultraquiet.values import Record, StateSpace
from ultraquiet.workbench.engine.making.imports import mapping_text
from ultraquiet.workbench.engine.making.laws import plan_of
from ultraquiet.workbench.engine.making.made import Tables


def read_channels(
    path: str | os.PathLike[str],
    rate_hz: float | None,
    inputs: Sequence[Mapping[str, Any]],
    outputs: Sequence[Mapping[str, Any]],
) -> Record:
    """Read a record from a file with channels as tables of a mapping; errors as in `files.read_record`.

    Args:
        path: of the file.
        rate_hz: samples per second; None leaves it to the file.
        inputs: for each input `column`, and perhaps `name`, `unit`, `scale`, `offset`, `limits`.
        outputs: likewise.
    """
    text = mapping_text({"rate_hz": rate_hz, "inputs": inputs, "outputs": outputs})
    return read_record(path, mapping=parse_mapping(text, f"channels of '{path}'"))


def plant(records: Mapping[str, Record], table: Mapping[str, Any]) -> StateSpace:
    """Return the model that `[plant]` of a study leads to.

    Args:
        records: by their names in the study.
        table: `[plant]`, as in a study file.

    Raises:
        InputError: as the stage `plant` of a study.
    """
    return identification.plant(records, Plant.model_validate(table)).values[stored.PLANT]


def further(
    records: Mapping[str, Record], table: Mapping[str, Any], tables: Mapping[str, Any]
) -> dict[str, StateSpace]:
    """Return the models of the further units that `[plant]` of a study names, by unit.

    Args:
        records: all that were measured, by their names in the study.
        table: `[plant]`, as in a study file.
        tables: `bench`, and `blending` where there is one, as in a study file.

    Raises:
        InputError: the bench knows no such unit.
    """
    later = {"later": {"design": {"method": "lqg"}}}  # a study wants a law, which does not change what is measured
    study = Study.model_validate({"study": {"title": "by hand"}, **tables, "plant": table, "controllers": later})
    return further_plants(study, records, Path())


def law(
    name: str,
    model: StateSpace,
    table: Mapping[str, Any],
    loop: Mapping[str, Any],
    others: Mapping[str, StateSpace] | None = None,
    around: StateSpace | None = None,
) -> StateSpace:
    """Return the law that `[controllers.NAME]` of a study leads to, reduced where the table says so.

    Args:
        name: of the law.
        model: G, `(ny, nu)`.
        table: `[controllers.NAME]`, as in a study file.
        loop: `[closed_loop]`: over which band and tones a reduction keeps what the law does.
        others: models of further units by name, for designs that hold on several.
        around: the law that the table puts this one round.

    Raises:
        KeyError: the design finds no law.
    """
    tables = Tables(ClosedLoop.model_validate(loop), Deploy(), None)
    made = control.designed(name, model, Design.model_validate(table), plan_of(model, tables), others, around)
    return made.values[name]
