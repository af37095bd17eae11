"""The demo study's controllers as code: attenuation on the bench through the compiled float32 code, and their cost.

Designed on the ground bench's true linear model (no identification, so that the figures are those of the code): each as
the study's file says, reduced and, where the study reduces, as it was before. The bench is the nonlinear one with its
noise; float64 law and compiled code meet the same noise.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.deploy import on_bench
from ultraquiet.deploy.c31 import cycles
from ultraquiet.pipeline.control import designed
from ultraquiet.pipeline.study import packaged_study

BUDGET, HALF = 2800, 1400
LOSS_DB = 0.5
LARGEST, LARGEST_ANTI_WINDUP = 170, 120

Row = tuple[str, str, str, bool]


def laws(plant: uq.StateSpace) -> Iterator[tuple[str, uq.StateSpace, bool]]:
    """Yield name, law and whether it was reduced, of every controller of the study that the bench can run."""
    for name, settings in packaged_study("suite").controllers.items():
        versions = [settings] if settings.reduce is None else [settings, settings.model_copy(update={"reduce": None})]
        for version in versions:
            started = time.perf_counter()
            found = designed(name, plant, version)
            law = found.values.get(name)
            print(f"# {name}: {found.facts.status} {time.perf_counter() - started:.0f} s", flush=True)
            if isinstance(law, uq.StateSpace):
                yield name, law, version.reduce is not None


def measure() -> Iterator[Row]:
    seed = int(np.random.default_rng().integers(2**30))
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    plant = bench.linear_model()
    with tempfile.TemporaryDirectory() as work:
        for name, law, reduced in laws(plant):
            title = f"{name}, {law.states} states{', reduced' if reduced else ''}"
            yield from _cost(title, law, reduced, plant, Path(work))
            yield from _on_bench(title, law, plant, bench, Path(work))
    yield from _limits(plant)


def _on_bench(title: str, law: uq.StateSpace, plant: uq.StateSpace, bench: uq.bench.Bench, work: Path) -> Iterator[Row]:
    made = uq.deploy.generate(law, work / "code", plant=plant)
    found = on_bench(bench, law, made.controller)
    loss = float(found.loss_db.max())
    reached = "/".join(f"{db:.2f}" for db in found.worst_code_db)
    lost = "/".join(f"{db:.4f}" for db in found.loss_db)
    figure = f"{reached} dB, lost {lost} dB ({made.tables['form']})"
    yield f"{title}: reduction at 5/25/100 Hz by float32 code", figure, f"{LOSS_DB} dB lost", loss < LOSS_DB


def _cost(title: str, law: uq.StateSpace, reduced: bool, plant: uq.StateSpace, work: Path) -> Iterator[Row]:
    """Yield the share of the C31's budget, with anti-windup too; what does not fit must be refused in words."""
    limit, target = (HALF, "half of 2800") if reduced else (BUDGET, "2800")
    tables = uq.deploy.generate(law, work / "cost", plant=plant).tables
    used = tables["c31_cycles"]
    figure = f"{used} cycles, {tables['form']}"
    if used <= limit:
        yield f"{title}: C31 model with the frame", figure, target, True
        return
    expected = law.states > LARGEST and not reduced
    try:
        uq.deploy.generate(law, work / "cost", plant=plant, enforce_budget=True)
        said = "not refused"
    except InputError as refusal:
        said = str(refusal)
    yield f"{title}: refused", f"{figure}: {said[-120:]}", "over 170 states", expected and "largest order" in said


def _limits(plant: uq.StateSpace) -> Iterator[Row]:
    """Yield the largest orders that fit, and that one pair of states more is refused with that order."""
    for anti_windup, largest in ((False, LARGEST), (True, LARGEST_ANTI_WINDUP)):
        title = "modal with anti-windup" if anti_windup else "modal"
        found = cycles.largest_order("modal", BUDGET, 6, 6, anti_windup=anti_windup)
        yield f"{title}: largest order in 2800", f"{found} states", f"{largest}", found >= largest
        for states in (largest, found + 2):
            said = _generated(states, anti_windup)
            fits = states <= found
            kept = (said == "fits") if fits else f"largest order that would fit is {found}" in said
            yield f"{title}: {states} states", said[:140], "fits" if fits else "refused with the order", kept


def _generated(states: int, anti_windup: bool) -> str:
    rng = np.random.default_rng()
    f_hz = np.geomspace(0.5, 400.0, states // 2) * rng.uniform(0.98, 1.02, states // 2)
    poles = np.exp(2 * np.pi * f_hz / 3500.0 * (-0.1 + 1j))
    A = np.zeros((states, states))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    B, C = 0.02 * rng.standard_normal((states, 6)), 0.02 * rng.standard_normal((6, states))
    law = uq.StateSpace(A, B, C, np.zeros((6, 6)), rate_hz=3500.0)
    with tempfile.TemporaryDirectory() as work:
        try:
            uq.deploy.generate(law, Path(work) / "code", form="modal", anti_windup=anti_windup, enforce_budget=True)
        except InputError as refusal:
            return str(refusal)
    return "fits"
