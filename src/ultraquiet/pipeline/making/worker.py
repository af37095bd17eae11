"""Stages of a study folder, made beside the process that walks the study; each is left in the folder.

`python -m ultraquiet.pipeline.making.worker identify FOLDER` identifies the records: it makes itself ready, and begins
when it is told so. `design FOLDER PLAN UNIT ...` designs the controllers, each said by its name when it is there, and
then finds the limits; PLAN is a `LoopPlan` in JSON, units are those whose models the designs are given besides.
"""

import json
import sys
from contextlib import suppress
from pathlib import Path
from threading import Event

from ultraquiet import files
from ultraquiet._base.beside import TICKS, Ticks, end_with_parent, tell
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.progress import listening
from ultraquiet._base.threads import one_blas_thread
from ultraquiet.pipeline import identification, limits
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.typed import from_plain
from ultraquiet.pipeline.making.designs import by_need, design_stage, identify_stage
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.store.recorded import finished_names
from ultraquiet.pipeline.study import reload_study
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


def design(folder: Path, plan: LoopPlan, units: list[str]) -> None:
    """Leave the stages of the designs and of the limits in the folder; whatever fails is left to who asks for it."""
    study, cache = reload_study(folder), Cache(folder, tell)
    plant = _model(folder, stored.PLANT)
    others = {unit: _model(folder, identification.of_unit(unit)) for unit in units}
    laws: dict[str, StateSpace] = {}
    for name in by_need(study):
        settings = study.controllers[name]
        with suppress(UltraquietError):
            around = laws.get(settings.around or "")
            laws |= design_stage(cache, name, settings, plant, plan, others, around).values
        print(name, TICKS // (1 + len(study.controllers)), sep="\n", flush=True)
    with suppress(UltraquietError):
        known = {name: laws[name] for name in study.controllers if name in laws}
        limits.stage(cache, study.limits, plant, known, plan.band_hz)


def _model(folder: Path, name: str) -> StateSpace:
    return files.load(folder / "models" / f"{name}.h5")  # type: ignore[no-any-return]


def main(job: str, folder: Path, words: list[str], begun: Event) -> None:
    """Do one job."""
    if job == "identify":
        identify(folder, begun)
        return
    with one_blas_thread():
        design(folder, from_plain(LoopPlan, json.loads(words[0])), words[1:])


if __name__ == "__main__":
    begun = end_with_parent()
    with suppress(KeyboardInterrupt):
        main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:], begun)
