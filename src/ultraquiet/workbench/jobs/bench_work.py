"""What is done with a bench: its list, a live look, closing a loop on it, and the whole study."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.progress import noted
from ultraquiet._base.tables import Method
from ultraquiet.linalg.response import principal_gains
from ultraquiet.pipeline import control, load_study, walk
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.typed import finite, to_plain
from ultraquiet.pipeline.preflight import loop_plan
from ultraquiet.pipeline.study import ClosedLoop, Study
from ultraquiet.pipeline.tables.blending import blended, in_modes
from ultraquiet.pipeline.walk import bench_of, measure
from ultraquiet.signals import Signal
from ultraquiet.values import StateSpace
from ultraquiet.values.channel import usual_level
from ultraquiet.values.sketch import sketch_of
from ultraquiet.workbench.engine.items import FOLDER
from ultraquiet.workbench.engine.making import work
from ultraquiet.workbench.engine.making.units import study_of
from ultraquiet.workbench.jobs.lane import STOP_FILE

FRAME_S = 0.05
LIVE_S = 3600.0


def asked_to_stop(folder: Path) -> bool:
    """Tell whether the stop button was pressed."""
    return (folder / FOLDER / STOP_FILE).exists()


def measured(folder: Path, state: Mapping[str, Any]) -> dict[str, Any]:
    """Execute the list of the study on its bench; records that are there stay, and stop ends it softly."""
    with noted("measure"):
        records = measure(study_of(state), folder, beside=folder, stop=lambda: asked_to_stop(folder))
    return {"records": {name: record.hash for name, record in records.items()}}


def described(folder: Path, state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bench's rate, channels and limits."""
    bench = bench_of(study_of(state), folder)
    sides = {"actuators": bench.actuators, "sensors": bench.sensors}
    rows = {side: [[c.name, c.unit, c.low, c.high] for c in wires] for side, wires in sides.items()}
    sketch = sketch_of(bench)
    drawn = {} if sketch is None else {"sketch": sketch.plain()}
    return finite({"rate_hz": bench.rate_hz, **rows, "name": type(bench).__name__, **drawn})


def live(folder: Path, state: Mapping[str, Any], signal: dict[str, Any], actuator: int) -> Iterator[dict[str, Any]]:
    """Yield what the bench reads, block by block at its own pace, while one actuator is driven; stop ends it softly."""
    bench = bench_of(study_of(state), folder)
    block = max(1, int(FRAME_S * bench.rate_hz))
    seconds = min(LIVE_S, 10.0)
    made = Method.model_validate(signal).make("signals")
    if isinstance(made, Signal):
        made = made.at(usual_level([bench.actuators[actuator]]))
    one = made.generate(int(seconds * bench.rate_hz), bench.rate_hz)
    actuation = np.zeros((len(bench.actuators), one.size))
    actuation[actuator] = one
    began, sent = time.monotonic(), 0
    while not asked_to_stop(folder) and time.monotonic() - began < LIVE_S:
        for part in bench.stream(actuation, block_samples=block, stop=lambda: asked_to_stop(folder)):
            sent += part.readings.shape[1]
            yield {
                "signals": np.vstack([part.command, part.readings]).astype("<f4"),
                "limited": [*map(int, part.limited_commands), *map(int, part.limited_readings)],
                "seconds": sent / bench.rate_hz,
            }
            ahead = sent / bench.rate_hz - (time.monotonic() - began)
            if ahead > 0:
                time.sleep(ahead)


def closed(folder: Path, state: dict[str, Any], law: str) -> dict[str, Any]:
    """Close the loop of a law on the bench of the study: does it settle, what does it do to tones and directions."""
    study = study_of(state)
    model = state["laws"][law]["model"]
    plant = work.make(folder, state, "models", model).value()
    bench = bench_of_plant(study, folder, plant)
    control.require_bench(bench, plant)
    system = work.make(folder, state, "laws", law).value()
    plan = loop_plan(ClosedLoop.model_validate(state["tables"].get("closed_loop", {})), bench, plant)
    with noted(f"close {law}"):
        outcome = control.closed(law, system, control.OpenLoops(bench, plan))
    curves = {}
    for unit in plan.units:
        S = outcome.values.get(stored.sensitivity(law, unit))
        if S is not None:
            sizes = principal_gains(S.values)
            curves[unit] = {"f_hz": S.f_hz.tolist(), "worst": sizes[0].tolist(), "best": sizes[-1].tolist()}
    return finite({"facts": to_plain(outcome.facts), "curves": curves})


def bench_of_plant(study: Study, folder: Path, plant: StateSpace) -> Any:
    """Return the study's bench with the channels and the rate of a plant.

    What is measured for a study in modes is driven through them and read sensor by sensor; files that were dropped may
    be in modes on both sides. Where none of these is the plant's, it is the bench itself.
    """
    own = bench_of(study, folder)
    if study.blending is None:
        return own
    benches = (blended(own, study.blending, folder), in_modes(own, study.blending, beside=folder))
    return next((bench for bench in benches if _wires(bench) == _wires(plant)), own)


def _wires(system: Any) -> tuple[Any, ...]:
    return system.rate_hz, *([c.name for c in side] for side in (system.actuators, system.sensors))


def whole(folder: Path, state: Mapping[str, Any]) -> dict[str, Any]:
    """Run the whole study from where it stands, as `ultraquiet run` does."""
    said: list[str] = []
    with noted("run the study"):
        summary = walk(load_study(folder / "study.toml"), folder, beside=folder, say=said.append)
    judged = [] if summary.requirements is None else [each.sentence for each in summary.requirements.judged]
    return {"said": said, "judged": judged, "failures": list(summary.failures)}
