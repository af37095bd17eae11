"""A law for a model, what its loop keeps, and its code."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet.design.loop_analysis import analyse_loop
from ultraquiet.pipeline import control
from ultraquiet.pipeline.facts.code import NoCode
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.making import code
from ultraquiet.pipeline.making.designs import design_stage
from ultraquiet.pipeline.preflight import LoopPlan, loop_plan
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.study import Design
from ultraquiet.values import Record, StateSpace
from ultraquiet.workbench.engine.making.made import Made, Tables

FORM = {  # settings of the code as Python or the command line names them, and as the form does
    "input_v (--range)": "'largest reading'",
    "output_v": "'largest command'",
    "precision='float32'": "the number format float32",
}
BY_CHANNEL = ("disk", "gain_up_db", "gain_down_db", "phase_deg", "delay_s")


def design_table(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """Return `[controllers.NAME]` of a study for a law on the boards."""
    further = {key: recipe[key] for key in ("reduce", "around") if recipe.get(key) is not None}
    return {"design": recipe["method"], **further}


def plan_of(plant: StateSpace, tables: Tables, bench: Any = None) -> LoopPlan:
    """Return what is measured of every law."""
    return loop_plan(tables.closed_loop, bench, plant)


def designed(
    name: str,
    plant: StateSpace,
    recipe: Mapping[str, Any],
    tables: Tables,
    stages: Cache | None = None,
    others: Mapping[str, StateSpace] | None = None,
    around: StateSpace | None = None,
) -> Made:
    """Design a law as the stage of a study does, and say what its loop keeps.

    With the `stages` of the study it is read from there where it is there, and left there for a run. `others` are the
    models of further units, for designs that hold on several; `around` is the law that the recipe puts this one round.

    Raises:
        InputError: the design found no law; the sentence says why.
    """
    plan = plan_of(plant, tables)
    settings = Design.model_validate(design_table(recipe))
    if stages is None:
        outcome = control.designed(name, plant, settings, plan, others, around)
    else:
        outcome = design_stage(stages, name, settings, plant, plan, others or {}, around)
    if name not in outcome.values:
        raise InputError(f"design: {outcome.facts.status}")
    law: StateSpace = outcome.values[name]
    facts = {"design": to_plain(outcome.facts), "states": law.states, "hash": law.hash}
    return Made({**facts, **loop_facts(plant, law, plan)}, {"value": law})


def loop_facts(plant: StateSpace, law: StateSpace, plan: LoopPlan) -> dict[str, Any]:
    """Return status, margins at both ends, peaks and the attenuation of the worst direction."""
    found = analyse_loop(plant, law, plan.band_hz)
    ends = {
        end: {"disk_all": float(at.disk_all), **{name: _floats(getattr(at, name)) for name in BY_CHANNEL}}
        for end, at in found.margins.items()
    }
    return {
        "status": str(found.status),
        "ok": found.status.ok,
        "margins": ends,
        "peaks": {name: [float(p.gain_db), float(p.f_hz), p.into, p.out_of] for name, p in found.peaks.items()},
        "band_hz": list(plan.band_hz),
        "attenuation_db": float(found.attenuation_db),
        "attenuation_hz": float(found.attenuation_hz),
    }


def deployed(
    name: str, law: StateSpace, plant: StateSpace, records: Iterable[Record], folder: Path, tables: Tables
) -> Made:
    """Write a law as C99, compile it and compare it, as the stage of a study does."""
    limits = control.command_limits(plant.actuators, records, tables.deploy)
    tones = plan_of(plant, tables).tones_hz
    facts = code.deployed(name, law, plant, limits, folder, tables.deploy, tones).facts
    if isinstance(facts, NoCode):
        raise InputError(f"deploy: {in_the_form(facts.status)}")
    return Made({"code": to_plain(facts), "status": facts.verdict, "limits": limits.tolist()})


def in_the_form(sentence: str) -> str:
    """Return a refusal of code with the settings that it names as the form on Deploy calls them.

    >>> in_the_form("refused: fixed_law: too much for a word of 16 bits; take q31 or a larger output_v.")
    "refused: fixed_law: too much for a word of 16 bits; take q31 or a larger 'largest command'."
    """
    for name, said in FORM.items():
        sentence = sentence.replace(name, said)
    return sentence


def _floats(values: Any) -> list[float]:
    return [float(v) for v in values]
