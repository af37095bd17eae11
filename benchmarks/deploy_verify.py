"""Verification: bits over a million steps here and over a hundred thousand on emulated Cortex-M4F and M7."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import ultraquiet as uq
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.deploy.verification.verify import Verification

RATE_HZ = 3500.0
HOST_STEPS, TARGET_STEPS = 1_000_000, 100_000
HALF_FRAME_S = 0.5 / RATE_HZ
STATES = 60

Row = tuple[str, str, str, bool]


def random_law(rng: np.random.Generator, states: int) -> uq.StateSpace:
    """Return lightly damped modes between 0.5 and 400 Hz in mixed coordinates, six by six."""
    f_hz = np.exp(rng.uniform(np.log(0.5), np.log(400.0), states // 2))
    damping = 10 ** rng.uniform(-2.5, -0.2, states // 2)
    poles = np.exp(2 * np.pi * f_hz * (-damping + 1j * np.sqrt(1 - damping**2)) / RATE_HZ)
    A = np.zeros((states, states))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    T = np.linalg.qr(rng.standard_normal((states, states)))[0]
    B, C = (0.3 / np.sqrt(states) * rng.standard_normal(shape) for shape in ((states, 6), (6, states)))
    return uq.StateSpace(T @ A @ T.T, T @ B, C @ T.T, 0.2 * rng.standard_normal((6, 6)), rate_hz=RATE_HZ)


def measure() -> Iterator[Row]:
    rng = np.random.default_rng()
    law = random_law(rng, STATES)
    cases: tuple[tuple[str, dict[str, Any]], ...] = (
        ("float32", {}),
        ("float32 with anti-windup", {"anti_windup": True}),
        ("float64", {"precision": "float64"}),
    )
    with tempfile.TemporaryDirectory() as work:
        for title, settings in cases:
            began = time.perf_counter()
            steps = TARGET_STEPS if settings else HOST_STEPS
            made = uq.deploy.generate(law, Path(work) / "code", form="modal", **settings)
            found = made.verify(steps, seed=int(rng.integers(2**30)))
            yield from _rows(f"{STATES} states, {title}", found, time.perf_counter() - began)


def _rows(title: str, found: Verification, seconds: float) -> Iterator[Row]:
    figure = f"{found.mismatches} differ of {found.steps} steps, {seconds:.0f} s"
    yield f"{title}: host against twin", figure, "every bit", found.bit_exact is True
    absent = missing_program()
    if absent is not None:
        yield f"{title}: emulated targets", f"'{absent}' is not installed", "tools", False
        return
    for name in TARGETS:
        each = found.on(name)
        if each is None:
            yield f"{title}: {name}", "; ".join(found.missing)[:120], "ran", False
            continue
        figure = f"{each.mismatches} differ of {each.steps}, self-test {'passed' if each.self_test else 'failed'}"
        yield f"{title}: {name}", figure, "every bit", each.bit_exact
        if "float64" in title and not each.target.doubles:
            continue  # a library computes; its instructions depend on the numbers
        figure = f"{each.step} at most, {each.calm} inside the limits"
        yield f"{title}: {name}, instructions a step", figure, "constant inside the limits", each.constant
        figure = f"{each.output}, {each.latency_us:.1f} us at {each.target.clock_hz / 1e6:g} MHz"
        kept = 1e-6 * each.latency_us < HALF_FRAME_S
        yield f"{title}: {name}, from measurement to command", figure, f"{1e6 * HALF_FRAME_S:.0f} us", kept
        yield f"{title}: {name}, flash and stack", f"{each.flash_bytes} and {each.stack_bytes} bytes", "known", True
