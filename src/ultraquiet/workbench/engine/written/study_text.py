"""The boards as a study file that `ultraquiet run` takes up, and the records it names."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ultraquiet import files
from ultraquiet._base.errors import UltraquietError
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
    campaign = tables.get("campaign")
    if campaign is not None and campaign.get("law", next(iter(laws), None)) in laws:
        kept["campaign"] = campaign
    return kept


def toml(state: State) -> str:
    """Return the study file, with how its records came about."""
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
    return "\n".join(lines) + "\n" + _tables((), content(state))


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


def _tables(place: tuple[str, ...], table: Mapping[str, Any]) -> str:
    """Return a table as TOML: its values, then its tables."""
    values = {key: value for key, value in table.items() if not isinstance(value, Mapping) and value is not None}
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    head = f"\n[{'.'.join(map(_key, place))}]\n" if place and (values or not inner) else ""
    body = "".join(f"{_key(key)} = {_value(value)}\n" for key, value in values.items())
    return head + body + "".join(_tables((*place, key), value) for key, value in inner.items())


def _key(key: str) -> str:
    return key if key.replace("-", "").replace("_", "").isalnum() and key.isascii() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(finite(value), ensure_ascii=False)
