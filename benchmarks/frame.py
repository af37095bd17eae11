"""A million frames of the compiled code at nominal load, and what overload does to it."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet.deploy.law.twin import FAULT, FAULT_OVERRUN, ON
from ultraquiet.deploy.toolchain.targets import missing_program

FRAMES, STATES, CHANNELS, RATE_HZ, LIMIT_S = 1_000_000, 60, 6, 3500.0, 10.0
PERIOD_S = 1.0 / RATE_HZ


def law_of(rng: np.random.Generator, states: int) -> uq.StateSpace:
    """Return a law of lightly damped modes between 0.5 and 400 Hz."""
    f_hz = np.exp(rng.uniform(np.log(0.5), np.log(400.0), states // 2))
    poles = np.exp(2 * np.pi * f_hz * (-0.05 + 1j) / RATE_HZ)
    A = np.zeros((states, states))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    size = 0.3 / np.sqrt(states)
    B, C = size * rng.standard_normal((states, CHANNELS)), size * rng.standard_normal((CHANNELS, states))
    return uq.StateSpace(A, B, C, 0.2 * rng.standard_normal((CHANNELS, CHANNELS)), rate_hz=RATE_HZ)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng = np.random.default_rng()
    seed = int(rng.integers(2**31))
    with tempfile.TemporaryDirectory() as work:
        for states in (STATES, 2 * STATES):
            made = uq.deploy.generate(law_of(rng, states), Path(work) / str(states), form="modal")
            yield from _nominal(made, seed)
        made = uq.deploy.generate(law_of(rng, STATES), Path(work) / "overload", form="modal")
        yield from _overload(made, seed)


def _nominal(made: uq.deploy.Deployment, seed: int) -> Iterator[tuple[str, str, str, bool]]:
    frame = uq.deploy.Frame(load=0.5, jitter_s=5e-6, contention=0.1)
    times = {"C31 model": uq.deploy.FrameTimes.c31(made.law)}
    if missing_program() is None:
        times["Cortex-M7 at 216 MHz"] = uq.deploy.FrameTimes.on_target(made)
    for processor, each in times.items():
        began = time.perf_counter()
        found = frame.simulate(made, FRAMES, times=each, seed=seed)
        seconds = time.perf_counter() - began
        what = f"{made.law.order} states, {processor}, {FRAMES} frames, half background, 5 us jitter"
        figure = f"{found.overrun_count} overruns, {found.late_count} late"
        yield what, figure, "0 overruns, 0 late", found.status.ok and found.overrun_count == 0
        slack = found.slack_s - 0.5 * found.period_s
        what = f"the same: slack left when background takes its half ({found.ran}, {seconds:.1f} s)"
        kept = slack > 0 and seconds < LIMIT_S
        yield what, f"{1e6 * slack:.1f} us, worst step end {1e6 * found.worst_s:.1f}", f"above 0, {LIMIT_S:g} s", kept


def _overload(made: uq.deploy.Deployment, seed: int) -> Iterator[tuple[str, str, str, bool]]:
    """Two seconds in which every step lasts another 1.2 frames, at a random place of a million frames."""
    first = int(np.random.default_rng(seed).integers(10_000, FRAMES // 2))
    injected = uq.deploy.Overload(first, 7000, 1.2 * PERIOD_S)
    frame = uq.deploy.Frame(load=0.1, jitter_s=5e-6, overloads=(injected,), restart_s=1.0)
    found = frame.simulate(made, FRAMES, seed=seed)
    skipped = int(np.count_nonzero(found.skipped))
    kept = found.overrun_count == found.hooked == skipped > 0 and found.refused == 0
    yield "overload: counter, hook, skipped frames", f"{found.overrun_count}, {found.hooked}, {skipped}", "equal", kept
    fault = int(np.flatnonzero(found.mode == FAULT)[0])
    spent, limit = int(found.overruns[fault]), made.law.overrun_limit
    kept = limit <= spent <= 2 * limit and int(found.faults[fault]) == FAULT_OVERRUN
    yield "overload: overruns before the fault latches", f"{spent}", f"{limit} to {2 * limit}", kept
    ran = np.flatnonzero(~found.skipped[fault:])[: made.law.ramp_steps] + fault
    level = found.level[ran].astype(int)
    kept = bool(np.all(np.diff(level) == -1)) and level[-1] == 0 and found.largest_v[ran[-1]] == 0.0
    yield "overload: steps of the ramp to zero", f"{level.size}, ends at level {level[-1]}", "one a step, to 0", kept
    last = int(np.flatnonzero(found.skipped)[-1])
    back = int(np.flatnonzero(found.mode == FAULT)[-1]) + 1
    waited = (back - last) * PERIOD_S
    kept = abs(waited - 1.0) < 0.01 and bool(np.all(found.mode[back:] == ON))
    kept = kept and int(found.level[-1]) == made.law.ramp_steps
    yield "overload: back in control after the last overrun", f"{waited:.3f} s", "1 s, then to the end", kept
