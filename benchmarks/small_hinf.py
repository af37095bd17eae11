"""Sixty small drawn H-infinity problems of six families, SLICOT's SB10AD beside each: seconds in sum, and one by one.

The peer bisects to a thousandth of the optimum from twice of it, which it is told; here the optimum is found to three
hundred-thousandths from nothing, the loop closed and its norm measured. What the peer fails on counts on neither side.
"""

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _peer
from benchmarks.hinf import PEER, PEER_TOLERANCE, START
from ultraquiet.design import synthesize_hinf
from ultraquiet.linalg.discretize import bilinear_to_continuous
from ultraquiet.values import StateSpace

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "design"))
from drawn_problems import problem

FAMILIES, DRAWS, REPEATS = ("cancellations", "delays", "dense", "integrators", "oscillators", "sampled"), 10, 3
SUM, LONG_S = 0.8, 0.01  # of the peer's time in sum; a problem that takes it longer is looked at by itself


def measure() -> Iterator[tuple[str, str, str, bool]]:
    seed = int(np.random.SeedSequence().entropy % 2**32)  # pyright: ignore[reportOperatorIssue]
    ours: dict[str, tuple[float, float]] = {}
    given: dict[str, Any] = {"repeats": np.array(REPEATS)}
    for family in FAMILIES:
        for draw in range(DRAWS):
            P, ny, nu = problem(family, seed + draw)
            name = f"{family}{draw}"
            gamma, seconds = timed(P, ny, nu)
            if not gamma > 0:
                continue
            ours[name] = gamma, seconds
            given |= {f"{name}_{k}": m for k, m in zip("ABCD", continuous(P), strict=True)}
            given |= {f"{name}_controls": np.array(nu), f"{name}_measurements": np.array(ny)}
            given |= {f"{name}_start": np.array(START * gamma), f"{name}_tolerance": np.array(PEER_TOLERANCE * gamma)}
    what, target = f"{len(ours)} small problems of seed {seed}, in sum", f"<= {SUM:g} x"
    try:
        with tempfile.TemporaryDirectory() as folder:
            python = _peer.environment("slycot", PEER)
            left = _peer.run(python, "_slycot.py", {**given, "names": np.array(" ".join(ours))}, Path(folder))
    except _peer.PeerError as why:
        yield what, f"not measured: {why}", target, False
        return
    theirs = {name: float(left[f"{name}_seconds"]) for name in ours}
    both = [name for name in ours if np.isfinite(theirs[name])]
    mine, its = sum(ours[name][1] for name in both), sum(theirs[name] for name in both)
    figure = f"{mine / its:.2f} x: {mine:.2f} s, it {its:.2f} s on the {len(both)} that it solves"
    yield what, figure, target, mine <= SUM * its
    ratios = {name: ours[name][1] / theirs[name] for name in both if theirs[name] > LONG_S}
    slowest = max(ratios, key=lambda name: ratios[name], default="")
    figure = f"{ratios[slowest]:.2f} x at most, {slowest}" if ratios else "none"
    yield f"{len(ratios)} that take it over 10 ms, each", figure, "<= 1 x", not ratios or ratios[slowest] <= 1


def timed(P: StateSpace, ny: int, nu: int) -> tuple[float, float]:
    """Return the norm reached, zero for a refusal, and the least processor time of some runs."""
    spent, gamma = [], 0.0
    for _ in range(REPEATS):
        started = time.process_time()
        result = synthesize_hinf(P, ny, nu, second_opinion=False)
        spent.append(time.process_time() - started)
        gamma = result.gamma if result.status.ok else 0.0
    return gamma, min(spent)


def continuous(P: StateSpace) -> tuple[np.ndarray, ...]:
    M = (P.A, P.B, P.C, P.D)
    return M if P.rate_hz is None else bilinear_to_continuous(*M)
