"""The boards as a study file that `ultraquiet run` takes up, and the records it names."""

import json
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ultraquiet import files
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet.pipeline.facts.typed import finite
from ultraquiet.workbench.engine.items import item_of, order
from ultraquiet.workbench.engine.making.laws import design_table
from ultraquiet.workbench.engine.making.models import plant_table
from ultraquiet.workbench.engine.steps import State
from ultraquiet.workbench.engine.written.own_files import renamed

DATA = "data"
# Tables of a study that are kept as they are.
PLAIN = ("identify", "paper", "validate", "closed_loop", "limits", "deploy")


def content(state: State) -> dict[str, Any]:
    """Return the tables of the study that stands on the boards: the chosen model and all laws for it."""
    model, tables = state["model"], state["tables"]
    study: dict[str, Any] = {"study": {"title": state["title"], **tables.get("study", {})}}
    for name in ("bench", "experiment", "blending"):
        if name in tables:
            study[name] = tables[name]
    if "experiment" not in tables:
        names = list(state["models"][model]["records"]) if model else list(state["data"])
        study["records"] = {"files": [f"{DATA}/{name}.h5" for name in names]}
    study |= {name: tables[name] for name in PLAIN if name in tables}
    if model:
        study["plant"] = plant_table(state["models"][model])
    laws = {name: design_table(recipe) for name, recipe in state["laws"].items() if recipe["model"] == model}
    if laws:
        study["controllers"] = laws
    study |= _on_a_bench(tables, laws)
    asked = tables.get("requirements")
    if asked is not None and state["law"] in laws:
        # what only a bench measures is asked of no study without one
        kept = asked if "bench" in tables else {key: asked[key] for key in ("band_hz", "disk_margin") if key in asked}
        study["requirements"] = {"law": state["law"], **kept}
    return study


def _on_a_bench(tables: Mapping[str, Any], laws: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables that a study without a bench, or without the law they name, refuses."""
    if "bench" not in tables:
        return {}
    kept = {"payload": tables["payload"]} if "payload" in tables else {}
    for name in ("campaign", "commission"):
        table = tables.get(name)
        if table is not None and table.get("law", next(iter(laws), None)) in laws:
            kept[name] = table
    return kept


def toml(state: State) -> str:
    """Return the study file, with how its records came about.

    Raises:
        InputError: a table of the boards holds what no study file can say.
    """
    lines = ["# Made by hand on the workbench; run it with:  ultraquiet run study.toml --out .", ""]
    model = state["model"]
    used = order(state, "models", model) if model else [("data", name) for name in state["data"]]
    for board, name in used:
        if board == "data":
            recipe = dict(state[board][name])
            lines.append(f"# {name}: {recipe.pop('op')} {json.dumps(recipe)}")
    missing = [what for what, there in (("a model", model), ("a law", state["laws"])) if not there]
    if missing:
        lines.append(f"# Not a whole study yet: it lacks {' and '.join(missing)}.")
    text = "\n".join(lines) + "\n" + _tables((), content(state))
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"workbench: no study file (TOML) can say what stands on the boards ({error}).") from error
    return text


def publish(folder: Path, state: State) -> None:
    """Write the records that the study file names, where they are there.

    Raises:
        StorageError: the disk refuses.
    """
    if "experiment" in state["tables"] or not state["model"]:
        return
    (folder / DATA).mkdir(exist_ok=True)
    for name in state["models"][state["model"]]["records"]:
        item = item_of(folder, state, "data", name)
        if item.ready:
            _copied(item.facts.get("hash"), item, folder / DATA / f"{name}.h5")


def _copied(digest: Any, item: Any, target: Path) -> None:
    note = target.with_suffix(".sha256")
    if target.exists() and note.exists() and note.read_text(encoding="utf-8") == digest:
        return
    if target.exists() and not note.exists() and not _holds(target, digest):
        renamed(target)  # nobody here wrote it
    files.save(item.value(), target)
    files.write_bytes(note, str(digest).encode())


def _holds(target: Path, digest: Any) -> bool:
    """Tell whether a file holds the record with a hash."""
    with suppress(UltraquietError, AttributeError):
        return files.load(target).hash == digest
    return False


def _tables(place: tuple[str, ...], table: Mapping[str, Any], one_of_many: bool = False) -> str:
    """Return a table as TOML: its values, then its tables and lists of tables."""
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping) or _are_tables(value)}
    values = {key: value for key, value in table.items() if key not in inner and value is not None}
    name = ".".join(map(_key, place))
    head = f"\n[{name}]\n" if place and (values or not inner) else ""
    body = "".join(f"{_key(key)} = {_value(value)}\n" for key, value in values.items())
    text = (f"\n[[{name}]]\n" if one_of_many else head) + body
    for key, value in inner.items():
        each = [(value, False)] if isinstance(value, Mapping) else [(one, True) for one in value]
        text += "".join(_tables((*place, key), one, many) for one, many in each)
    return text


def _are_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(each, Mapping) for each in value)


def _key(key: str) -> str:
    return key if key.replace("-", "").replace("_", "").isalnum() and key.isascii() else _text(key)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        kept = {str(key): each for key, each in value.items() if each is not None}
        return f"{{{', '.join(f'{_key(key)} = {_value(each)}' for key, each in kept.items())}}}"
    if isinstance(value, float):
        return repr(value)
    return _text(value) if isinstance(value, str) else json.dumps(finite(value))


def _text(text: str) -> str:
    """Return a string of TOML, whose escapes are those of JSON but for one character that JSON takes as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
