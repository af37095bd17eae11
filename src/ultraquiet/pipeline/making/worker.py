"""Stages of a study folder, made beside the process that walks the study; each is left in the folder.

`python -m ultraquiet.pipeline.making.worker identify FOLDER` identifies the records: it makes itself ready, and begins
when it is told so. `design FOLDER NUMBERS PLAN UNIT ...` designs the controllers, each said by its name when it is
there, and finds the limits once it is told that all are. NUMBERS is an open file, from which it takes what is its own
to do: numbers of `chains`, and one more for the limits. PLAN is a `LoopPlan` in JSON, units are those whose models the
designs are given besides.
"""

import json
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event

from ultraquiet import files
from ultraquiet._base.beside import TICKS, Ticks, end_with_parent, tell, turns
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.progress import listening
from ultraquiet._base.threads import one_blas_thread
from ultraquiet.pipeline import identification, limits
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.typed import from_plain
from ultraquiet.pipeline.making.designs import by_need, chains, design_key, design_stage, identify_stage
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.store.recorded import finished_names
from ultraquiet.pipeline.study import Design, Study, reload_study
from ultraquiet.values import Record, StateSpace

AT_ONCE_S = 0.1  # within which it is told to begin where the records are there already


def identify(folder: Path, begun: Event) -> None:
    """Leave the stage `identify` in the folder, once its records are there."""
    if not begun.wait(AT_ONCE_S):
        identification.prepare(reload_study(folder).identify)
        begun.wait()
    names = finished_names(folder)
    records: dict[str, Record] = {name: files.load(folder / "records" / f"{name}.h5") for name in names}
    with listening(Ticks()):
        identify_stage(Cache(folder, tell), reload_study(folder), records)


def design(folder: Path, numbers: Iterable[int], plan: LoopPlan, units: list[str], begun: Event) -> None:
    """Leave the stages of the designs and of the limits in the folder; whatever fails is left to who asks for it."""
    study = reload_study(folder)
    makes = _Designs(study, Cache(folder, tell), folder, plan, units)
    jobs = chains(study)
    for number in numbers:
        if number < len(jobs):
            makes.chain(jobs[number])
        else:
            begun.wait()
            makes.limits()


class _Designs:
    """The designs of a study, and their limits."""

    def __init__(self, study: Study, cache: Cache, folder: Path, plan: LoopPlan, units: list[str]) -> None:
        self._study, self._cache, self._plan = study, cache, plan
        self._plant = _model(folder, stored.PLANT)
        self._others = {unit: _model(folder, identification.of_unit(unit)) for unit in units}

    def chain(self, names: list[str]) -> None:
        """Make laws that stand round one another."""
        laws: dict[str, StateSpace] = {}
        for name in names:
            with suppress(UltraquietError):
                laws |= self._made(name, laws)
            print(name, TICKS // (1 + len(self._study.controllers)), sep="\n", flush=True)

    def limits(self) -> None:
        """Find the limits, all laws being there that will be."""
        laws: dict[str, StateSpace] = {}
        for name in by_need(self._study):
            settings, around = self._table(name, laws)
            key = design_key(self._plant, settings, self._plan, self._others, around)
            if self._cache.holds(f"design-{name}", key):
                laws |= self._made(name, laws)
        known = {name: laws[name] for name in self._study.controllers if name in laws}
        with suppress(UltraquietError):
            limits.stage(self._cache, self._study.limits, self._plant, known, self._plan.band_hz)

    def _made(self, name: str, laws: dict[str, StateSpace]) -> Mapping[str, StateSpace]:
        settings, around = self._table(name, laws)
        return design_stage(self._cache, name, settings, self._plant, self._plan, self._others, around).values

    def _table(self, name: str, laws: Mapping[str, StateSpace]) -> tuple[Design, StateSpace | None]:
        """Return a law's table, and the law inside it."""
        settings = self._study.controllers[name]
        return settings, laws.get(settings.around or "")


def _model(folder: Path, name: str) -> StateSpace:
    return files.load(folder / "models" / f"{name}.h5")  # type: ignore[no-any-return]


def main(job: str, folder: Path, words: list[str], begun: Event) -> None:
    """Do one job."""
    if job == "identify":
        identify(folder, begun)
        return
    with one_blas_thread():
        design(folder, turns(int(words[0])), from_plain(LoopPlan, json.loads(words[1])), words[2:], begun)


if __name__ == "__main__":
    begun = end_with_parent()
    with suppress(KeyboardInterrupt):
        main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:], begun)
