"""What a step of the generated code costs a Cortex-M7, and that no step costs more than another."""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ultraquiet.deploy import generate
from ultraquiet.deploy.c_code.footprint import footprint_on
from ultraquiet.deploy.deployment import Deployment
from ultraquiet.deploy.toolchain.emulator import run_on_target
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.deploy.verification.verify import measurements
from ultraquiet.values import StateSpace

RATE_HZ, CHANNELS = 3500.0, 6
# 3100 at 60 states and in proportion to the multiply-adds at 120; at 30, where the guards weigh more, four for each.
MOST = {30: 4 * 456, 60: 3100, 120: 3100 * 1716 // 876}
STEPS, RAMP_S = 3000, 0.02
TAIL = 50  # `measurements` puts its NaN so many steps before the end


def measure() -> Iterator[tuple[str, str, str, bool]]:
    absent = missing_program()
    if absent is not None:
        yield "instructions of a step on a Cortex-M7", f"'{absent}' is not installed", "to be counted", False
        return
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as work:
        for states, target in MOST.items():
            made = generate(modal_law(rng, states), Path(work) / str(states), form="modal", ramp_s=RAMP_S)
            step, in_control = counted(made)
            floor = 14 * states + 36
            most = int(step.max())
            what = f"Cortex-M7 instructions a step, {states} states, 6 x 6"
            told = f"{most}, {most / floor:.2f} a multiply-add"
            yield what, told, f"at most {target} (14 n + 36 = {floor})", most <= target
            spread = int(np.ptp(step[in_control]))
            varied = f"{spread} over {np.count_nonzero(in_control)} steps"
            yield "its spread: ramp, limits, calm and bursts", varied, "0", spread == 0
            rest = int(step[~in_control].max(initial=0))
            yield "its longest step with a fault or off", str(rest), "under a step in control", 0 < rest < most
            yield from small_code(made, states)


def small_code(made: Deployment, states: int) -> Iterator[tuple[str, str, str, bool]]:
    """Compile the same files with `-Os` in place of `-O2`: instructions and bytes, and the same bits."""
    y = measurements(made.plan, STEPS, 1)
    for target in TARGETS.values():
        small = replace(target, flags=(*target.flags, "-Os"))  # the last of two levels is the one that counts
        fast_run, small_run = (run_on_target(made.law, made.folder, y, one) for one in (target, small))
        flash, small_flash = (footprint_on(made.law, made.folder, one).flash_bytes or 0 for one in (target, small))
        most, small_most = int(fast_run.step.max()), int(small_run.step.max())
        told = f"{small_most} instructions to {most} ({small_most / most:.2f}), {small_flash} bytes to {flash}"
        same = np.array_equal(fast_run.u.view(np.uint32), small_run.u.view(np.uint32))
        yield f"{target.title}, -Os to -O2, {states} states", told, "the same bits", same


def counted(made: Deployment) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return instructions of steps through ramp, bursts beyond limits and a bad measurement; which came before it."""
    run = run_on_target(made.law, made.folder, measurements(made.plan, STEPS, 1))
    return run.step, np.arange(STEPS) < STEPS - TAIL


def modal_law(rng: np.random.Generator, states: int) -> StateSpace:
    """Return a law of lightly damped modes, 0.5 to 400 Hz."""
    w = 2 * np.pi * np.geomspace(0.5, 400.0, states // 2)
    zeta = rng.uniform(0.01, 0.3, states // 2)
    poles = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w / RATE_HZ)
    A = np.asarray(block_diag(*[[[p.real, p.imag], [-p.imag, p.real]] for p in poles]))
    B, C = 0.05 * rng.standard_normal((states, CHANNELS)), 0.05 * rng.standard_normal((CHANNELS, states))
    return StateSpace(A, B, C, 0.2 * rng.standard_normal((CHANNELS, CHANNELS)), rate_hz=RATE_HZ)
