"""The boards as a Python script: one line a step, which gives the same numbers when it is run in the study's folder."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from keyword import iskeyword
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.registry import lookup, older_names
from ultraquiet.pipeline.making import code
from ultraquiet.pipeline.making.designs import takes_several
from ultraquiet.pipeline.study import Design
from ultraquiet.workbench.engine.items import item_of
from ultraquiet.workbench.engine.making.imports import CHANNEL_KEYS
from ultraquiet.workbench.engine.making.laws import design_table
from ultraquiet.workbench.engine.making.made import tables_of
from ultraquiet.workbench.engine.making.models import plant_table
from ultraquiet.workbench.engine.steps import BOARDS, State

HEAD = '''"""{title}: every step that was taken by hand; run it in the study's folder."""

import ultraquiet as uq
from ultraquiet import files, workbench
'''
PREFIX = {"data": "record", "models": "model", "laws": "law", "codes": "code"}


def script(state: State, folder: Path) -> str:
    """Return the script of all items of the boards, in an order in which each can be made."""
    lines = [HEAD.format(title=state["title"].replace('"', "'"))]
    for board in BOARDS:
        for name in state[board]:
            lines += lines_of(state, folder, board, name)
    return "\n".join(lines) + "\n"


def lines_of(state: State, folder: Path, board: str, name: str) -> list[str]:
    """Return the lines that make one item; for most it is one."""
    recipe = state[board][name]
    return _WRITERS[recipe["op"]](_variable(board, name), name, recipe, state, folder)


def _variable(board: str, name: str) -> str:
    """Return a Python name that no other item has.

    >>> _variable("data", "noise-1"), _variable("data", "noise.1")
    ('record_noise_1', 'record_noisex2e1')
    """
    bare = re.sub(r"[^A-Za-z0-9_-]", lambda found: f"x{ord(found[0]):x}", name).replace("_", "__").replace("-", "_")
    return f"{PREFIX[board]}_{bare}"


def _imported(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    if not recipe["inputs"] and not recipe["outputs"]:
        return [f"{variable} = files.read_record({recipe['file']!r}, {recipe['rate_hz']!r})"]
    sides = {
        side: [{key: one[key] for key in CHANNEL_KEYS if one.get(key) is not None} for one in recipe[side]]
        for side in ("inputs", "outputs")
    }
    return [
        f"{variable} = workbench.read_channels({recipe['file']!r}, {recipe['rate_hz']!r}, {sides['inputs']!r}, "
        f"{sides['outputs']!r})"
    ]


def _measured(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    return [f"{variable} = files.load({recipe['file']!r})"]


def _cut(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    return [f"{variable} = {_variable('data', recipe['of'])}.part({recipe['start']}, {recipe['stop']})"]


def _detrended(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    return [f"{variable} = workbench.detrended({_variable('data', recipe['of'])}, {recipe['kind']!r})"]


def _model(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    records = recipe["records"]
    if len(records) == 1 and recipe.get("period_samples") is None:
        settings = _settings("identify", recipe["method"])
        first = f"{variable} = {settings}.identify({_variable('data', records[0])}).state_space()"
    else:
        first = f"{variable} = workbench.plant({_given(records)}, {plant_table(recipe)!r})"
    if not recipe.get("units"):
        return [first]
    tables = {key: state["tables"][key] for key in ("bench", "blending") if key in state["tables"]}
    measured = [each for each, one in state["data"].items() if one["op"] == "measure"] or records
    return [
        first,
        f"{variable}_units = workbench.further({_given(measured)}, {plant_table(recipe)!r}, {tables!r})",
    ]


def _given(records: Sequence[str]) -> str:
    """Return records by their names as Python."""
    return "{" + ", ".join(f"{each!r}: {_variable('data', each)}" for each in records) + "}"


def _law(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    model = _variable("models", recipe["model"])
    table = design_table(recipe)
    several = state["models"][recipe["model"]].get("units") and takes_several(Design.model_validate(table))
    inner = recipe.get("around")
    if recipe.get("reduce") is None and not several and inner is None:
        return [f"{variable} = {_settings('design', recipe['method'])}.design({model}).controller"]
    loop = state["tables"].get("closed_loop", {})
    others = f", {model}_units" if several else ""
    inside = "" if inner is None else f", around={_variable('laws', inner)}"
    return [f"{variable} = workbench.law({name!r}, {model}, {table!r}, {loop!r}{others}{inside})"]


def _code(variable: str, name: str, recipe: Mapping[str, Any], state: State, folder: Path) -> list[str]:
    law = recipe["law"]
    model = state["laws"][law]["model"]
    asked = tables_of(state).deploy
    limits: Any = item_of(folder, state, "codes", name).facts.get("limits")
    call = "generate_fixed" if asked.whole_numbers else "generate"
    ranges = code.full_ranges(limits, asked) if asked.whole_numbers else {"limits_v": limits}
    settings = {**ranges, **{key: value for key, value in code.options(asked).items() if key in asked.model_fields_set}}
    words = "".join(f", {key}={value!r}" for key, value in settings.items())
    return [
        f"{variable} = uq.deploy.{call}({_variable('laws', law)}, {f'code/{law}'!r}, {asked.precision!r}"
        f"{words}, plant={_variable('models', model)})"
    ]


def _settings(family: str, method: Mapping[str, Any]) -> str:
    """Return the settings object of a table as Python: `uq.identify.BoxJenkins(order=5)`."""
    try:
        kind = lookup(family, method["method"])
    except UltraquietError:
        return f"uq.{family}.{method['method']}"
    older, given = older_names(kind), {key: value for key, value in method.items() if key != "method"}
    settings = {older.get(key, key): tuple(v) if isinstance(v, list) else v for key, v in given.items()}
    known = [field.name for field in fields(kind)]
    words = [f"{key}={settings[key]!r}" for key in known if key in settings and not iskeyword(key)]
    return f"uq.{family}.{kind.__name__}({', '.join(words)})"


_WRITERS = {
    "import": _imported,
    "measure": _measured,
    "cut": _cut,
    "detrend": _detrended,
    "identify": _model,
    "design": _law,
    "deploy": _code,
}
