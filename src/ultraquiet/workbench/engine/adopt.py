"""A study that `ultraquiet run` left, taken over onto the boards as it is."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet.experiments import journal
from ultraquiet.pipeline.identification import grouped
from ultraquiet.pipeline.store.recorded import FOLDER
from ultraquiet.pipeline.study import Study, reload_study
from ultraquiet.workbench.engine.items import Item


def steps_of(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the steps that lead to a folder's study; none where no study ran there."""
    if not (folder / "study.json").exists():
        return
    study = reload_study(folder)
    yield {"op": "title", "title": study.study.title}
    content = study.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    content.pop("records", None)
    asked = content.pop("requirements", None)
    for name, values in content.items():
        if name not in ("plant", "controllers"):
            kept = {k: v for k, v in values.items() if (name, k) != ("study", "title")}
            yield {"op": "table", "table": name, "values": kept}
    yield from _boards(study, folder)
    if asked is not None:
        yield {"op": "choose", "law": asked.pop("law")}
        yield {"op": "table", "table": "requirements", "values": asked}


def measured_anew(folder: Path, items: Iterable[Item]) -> Iterator[dict[str, Any]]:
    """Yield a step for every record that is another one than its item was made of, as the folder's journal says."""
    finished: dict[str, str] = {}
    with suppress(StorageError):  # whoever measures into the folder says so
        entries = journal.entries(folder / FOLDER)
        finished = {e["name"]: e["record"] for e in entries if e["event"] == "finished" and "record" in e}
    for item in items:
        name = Path(item.recipe.get("file", "")).stem
        if item.recipe["op"] != "measure" or item.recipe.get("file") != f"{FOLDER}/{name}.h5":
            continue
        known = None
        with suppress(StorageError):
            known = item.recipe.get("hash") or item.facts.get("hash")
        found = finished.get(name)
        if found is not None and known is not None and found != known:
            yield {**item.recipe, "name": item.name, "hash": found}


def _boards(study: Study, folder: Path) -> Iterator[dict[str, Any]]:
    names = sorted(path.stem for path in (folder / FOLDER).glob("[!.]*.h5") if ".partial" not in path.name)
    for name in names:
        yield {"op": "measure", "name": name, "file": f"{FOLDER}/{name}.h5"}
    groups = grouped(names)
    wanted = [each for group in study.plant.records for each in groups.get(group, [group])]
    if not set(wanted) <= set(names):
        return
    method = {"method": study.plant.method, **_plain(study.plant.settings)}
    period = study.plant.period_samples
    units = {"units": list(study.plant.units)} if study.plant.units else {}
    yield {"op": "identify", "name": "plant", "records": wanted, "period_samples": period, "method": method, **units}
    for name, law in study.controllers.items():
        tables = [None if t is None else {"method": t.method, **_plain(t.settings)} for t in (law.design, law.reduce)]
        inside = {} if law.around is None else {"around": law.around}
        yield {"op": "design", "name": name, "model": "plant", "method": tables[0], "reduce": tables[1], **inside}


def _plain(settings: Any) -> dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in settings.items()}
