"""What is computed to make an item: the pipeline's own stages, so that a study that is run gives the same numbers."""

import json
import shutil
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import files
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.progress import noted
from ultraquiet._base.threads import single_threaded
from ultraquiet.pipeline.facts.typed import finite
from ultraquiet.pipeline.identification import of_unit
from ultraquiet.pipeline.making.designs import takes_several
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.store.lock import locked
from ultraquiet.pipeline.study import Design
from ultraquiet.validate import advise
from ultraquiet.values import Record
from ultraquiet.workbench.engine.items import FACTS, VALUES, Item, item_of, order
from ultraquiet.workbench.engine.making import laws, models
from ultraquiet.workbench.engine.making.imports import read_import
from ultraquiet.workbench.engine.making.made import Made, tables_of
from ultraquiet.workbench.engine.making.prepare import detrended
from ultraquiet.workbench.engine.making.units import of_units
from ultraquiet.workbench.engine.steps import State, parents

CODE = "code"


@single_threaded
def make(folder: Path, state: State, board: str, name: str, shared: bool = False) -> Item:
    """Make an item and all it is made of that is not there yet, and return it.

    Each appears whole or not at all: its values are written beside and take their place by one rename.

    Args:
        folder: of the study.
        state: its boards.
        board: on which the item stands.
        name: of the item.
        shared: whether the stages of the study in this folder are reused, and left for `ultraquiet run` to reuse.

    Raises:
        UltraquietError: what the method refuses; what was made before it stays.
    """
    for each in order(state, board, name):
        item = item_of(folder, state, *each)
        if not item.ready:
            with noted(f"{item.recipe['op']} {item.name}"):
                _keep(item, _MAKERS[item.recipe["op"]], folder, state, shared)
    return item_of(folder, state, board, name)


_Maker = Callable[[Item, "Surroundings"], Made]


class Surroundings:
    """What a maker may ask for: the study's folder and tables, values of other items, a folder to write code to."""

    def __init__(self, folder: Path, state: State, code: Path, shared: bool = False) -> None:
        self.folder, self.state, self.code = folder, state, code
        self.stages = stages_of(folder) if shared else nullcontext(None)
        self.tables = tables_of(state)

    def record(self, name: str) -> Record:
        """Return a record, read first where nobody has looked at it yet."""
        return make(self.folder, self.state, "data", name).value()

    def value(self, board: str, name: str, which: str = "value") -> Any:
        """Return a value of an item that is ready."""
        return item_of(self.folder, self.state, board, name).value(which)

    def facts(self, board: str, name: str) -> Mapping[str, Any]:
        """Return the facts of an item that is ready."""
        return item_of(self.folder, self.state, board, name).facts

    def recipe(self, board: str, name: str) -> Mapping[str, Any]:
        """Return how an item is made."""
        return self.state[board][name]


def _keep(item: Item, maker: _Maker, folder: Path, state: State, shared: bool = False) -> None:
    part = item.folder.with_name(f".{item.folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        _write(part, item, maker(item, Surroundings(folder, state, part / CODE, shared)), state)
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


@contextmanager
def stages_of(folder: Path) -> Generator[Cache | None]:
    """Yield the stages of the study in a folder; None while a run is at work there, which must not be disturbed."""
    with ExitStack() as held:
        try:
            lock = held.enter_context(locked(folder, lambda _: None))
        except StorageError:
            yield None
            return
        yield Cache(folder, lock=lock)


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
    if around.state["model"] != item.name:  # a study has one plant: the others are candidates beside it
        made = models.identified(records, item.recipe)
        return Made(made.facts, {**made.values, **of_units(around.folder, around.state, item.recipe, records)})
    measured = [name for name, recipe in around.state["data"].items() if recipe["op"] == "measure"]
    hashes = {name: records[name].hash if name in records else around.record(name).hash for name in measured}
    with around.stages as cache:
        made = models.identified(records, item.recipe, cache, hashes if measured else None)
        every = records if not item.recipe.get("units") else {n: around.record(n) for n in measured or records}
        others = of_units(around.folder, around.state, item.recipe, every, cache)
        return Made(made.facts, {**made.values, **others})


def _law(item: Item, around: Surroundings) -> Made:
    model = item.recipe["model"]
    plant, units = around.value("models", model), around.recipe("models", model).get("units") or ()
    several = takes_several(Design.model_validate(laws.design_table(item.recipe)))
    others = {unit: around.value("models", model, of_unit(unit)) for unit in units} if several else {}
    inner = item.recipe.get("around")
    inside = None if inner is None else around.value("laws", inner)
    with around.stages as cache:
        return laws.designed(item.name, plant, item.recipe, around.tables, cache, others, inside)


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
