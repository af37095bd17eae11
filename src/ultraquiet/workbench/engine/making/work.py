"""What is computed to make an item: the pipeline's own stages, so that a study that is run gives the same numbers."""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import files
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.progress import noted
from ultraquiet._base.threads import single_threaded
from ultraquiet.pipeline.facts.typed import finite
from ultraquiet.validate import advise
from ultraquiet.values import Record
from ultraquiet.workbench.engine.items import FACTS, VALUES, Item, item_of, order
from ultraquiet.workbench.engine.making import laws, models
from ultraquiet.workbench.engine.making.imports import read_import
from ultraquiet.workbench.engine.making.made import Made, tables_of
from ultraquiet.workbench.engine.making.prepare import detrended
from ultraquiet.workbench.engine.steps import State, parents

CODE = "code"


@single_threaded
def make(folder: Path, state: State, board: str, name: str) -> Item:
    """Make an item and all it is made of that is not there yet, and return it.

    Each appears whole or not at all: its values are written beside and take their place by one rename.

    Raises:
        UltraquietError: what the method refuses; what was made before it stays.
    """
    for each in order(state, board, name):
        item = item_of(folder, state, *each)
        if not item.ready:
            with noted(f"{item.recipe['op']} {item.name}"):
                _keep(item, _MAKERS[item.recipe["op"]], folder, state)
    return item_of(folder, state, board, name)


_Maker = Callable[[Item, "Surroundings"], Made]


class Surroundings:
    """What a maker may ask for: the study's folder and tables, values of other items, a folder to write code to."""

    def __init__(self, folder: Path, state: State, code: Path) -> None:
        self.folder, self.state, self.code = folder, state, code
        self.tables = tables_of(state)

    def value(self, board: str, name: str, which: str = "value") -> Any:
        """Return a value of an item that is ready."""
        return item_of(self.folder, self.state, board, name).value(which)

    def facts(self, board: str, name: str) -> Mapping[str, Any]:
        """Return the facts of an item that is ready."""
        return item_of(self.folder, self.state, board, name).facts

    def recipe(self, board: str, name: str) -> Mapping[str, Any]:
        """Return how an item is made."""
        return self.state[board][name]


def keep_made(item: Item, made: Made, state: State) -> None:
    """Keep values of an item that were made elsewhere from the very same recipe.

    Raises:
        StorageError: the disk refuses.
    """
    _keep(item, lambda *_: made, item.folder, state)


def _keep(item: Item, maker: _Maker, folder: Path, state: State) -> None:
    part = item.folder.with_name(f".{item.folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        _write(part, item, maker(item, Surroundings(folder, state, part / CODE)), state)
        shutil.rmtree(item.folder, ignore_errors=True)
        part.rename(item.folder)
    except OSError as error:
        if isinstance(error, UltraquietError):
            raise
        raise StorageError(f"workbench: '{item.name}' could not be written ({files.reason(error)}).") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write(part: Path, item: Item, made: Made, state: State) -> None:
    if made.values:
        files.save_many(made.values, part / VALUES)
    above = {f"{b}/{n}": dict(state[b][n]) for b, n in order(state, item.board, item.name)}
    facts = {**made.facts, "name": item.name, "recipes": above}
    files.write_bytes(part / FACTS, json.dumps(finite(facts)).encode())


def _imported(item: Item, around: Surroundings) -> Made:
    return _record_made(read_import(around.folder, item.recipe))


def _measured(item: Item, around: Surroundings) -> Made:
    return _record_made(files.load(around.folder / item.recipe["file"]))


def _cut(item: Item, around: Surroundings) -> Made:
    record: Record = around.value("data", item.recipe["of"])
    return _record_made(record.part(item.recipe["start"], item.recipe["stop"]))


def _detrended(item: Item, around: Surroundings) -> Made:
    return _record_made(detrended(around.value("data", item.recipe["of"]), item.recipe["kind"]))


def _record_made(record: Record) -> Made:
    """Return a record with what a look at it says: levels, clipping, what should be mended."""
    rms = np.sqrt(np.mean(np.square(np.vstack([record.inputs, record.outputs])), axis=1))
    facts = {
        "samples": record.samples,
        "rate_hz": record.rate_hz,
        "duration_s": record.duration_s,
        "actuators": [[c.name, c.unit] for c in record.actuators],
        "sensors": [[c.name, c.unit] for c in record.sensors],
        "rms": rms.tolist(),
        "clipped": list(record.clipped()),
        "advice": [str(each) for each in advise(record)],
        "hash": record.hash,
    }
    return Made(facts, {"value": record})


def _model(item: Item, around: Surroundings) -> Made:
    records = {name: around.value("data", name) for name in item.recipe["records"]}
    return models.identified(records, item.recipe)


def _law(item: Item, around: Surroundings) -> Made:
    plant = around.value("models", item.recipe["model"])
    return laws.designed(item.name, plant, item.recipe, around.tables)


def _code(item: Item, around: Surroundings) -> Made:
    law = item.recipe["law"]
    model = around.recipe("laws", law)["model"]
    names = [name for board, name in parents(around.recipe("models", model)) if board == "data"]
    records = [around.value("data", name) for name in names]
    value = around.value("laws", law)
    return laws.deployed(law, value, around.value("models", model), records, around.code, around.tables)


_MAKERS: dict[str, _Maker] = {
    "import": _imported,
    "measure": _measured,
    "cut": _cut,
    "detrend": _detrended,
    "identify": _model,
    "design": _law,
    "deploy": _code,
}
