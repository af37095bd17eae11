"""Balanced truncation of 48, 348 and 1000 lightly damped states beside SLICOT's AB09AD: time and error."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _peer
from ultraquiet.analyse import hinf_norm
from ultraquiet.reduce import Balanced
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import parallel

PEER = ("slycot==0.7.1", "control==0.10.2")
STATES, CHANNELS, KEPT = (48, 348, 1000), 3, 4  # one state in four is kept
REPEATS = {48: 100, 348: 5, 1000: 3}  # of which the quickest counts: the shorter, the more a neighbour disturbs
COMPARED = 348  # states up to which the errors are compared too: a norm of twice as many takes as long as all else
EQUAL = 1.001


def measure() -> Iterator[tuple[str, str, str, bool]]:
    seed = int(np.random.SeedSequence().entropy % 2**32)  # pyright: ignore[reportOperatorIssue]
    plants = {n: modes(np.random.default_rng([seed, n]), n) for n in STATES}
    ours = {n: timed(G, n // KEPT, REPEATS[n]) for n, G in plants.items()}
    given: dict[str, Any] = {
        "names": np.array(" ".join(f"n{n}" for n in plants)),
    }
    for n, G in plants.items():
        given |= {
            f"n{n}_repeats": np.array(REPEATS[n]),
            f"n{n}_A": G.A,
            f"n{n}_B": G.B,
            f"n{n}_C": G.C,
            f"n{n}_order": np.array(n // KEPT),
        }
    try:
        with tempfile.TemporaryDirectory() as folder:
            left = _peer.run(_peer.environment("slycot", PEER), "_ab09ad.py", given, Path(folder))
    except _peer.PeerError as why:
        for n, (_, seconds) in ours.items():
            yield f"{n} states against SLICOT AB09AD", f"{seconds:.3f} s; not measured: {why}", "<= 1 x", False
        return
    for n, (reduced, seconds) in ours.items():
        theirs = float(left[f"n{n}_seconds"])
        figure = f"{seconds / theirs:.2f} x: {1e3 * seconds:.2f} ms, it {1e3 * theirs:.2f} ms, seed {seed}"
        yield f"{n} states to {n // KEPT}, against SLICOT AB09AD", figure, "<= 1 x", seconds <= theirs
        if n <= COMPARED:
            A, B, C = (left[f"n{n}_{k}"] for k in "ABC")
            peer = StateSpace(A, B, C, np.zeros((CHANNELS, CHANNELS)))
            mine, its = error(plants[n], reduced), error(plants[n], peer)
            yield f"{n} states, error over its", f"{mine / its:.6f}", f"<= {EQUAL:g}", mine <= EQUAL * its


def modes(rng: np.random.Generator, states: int) -> StateSpace:
    """Return modes over three decades, 1 % damped, in coordinates that show none of them."""
    pairs, A = states // 2, np.zeros((states, states))
    for k, w in enumerate(10 ** rng.uniform(0, 3, pairs)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w], [-w, -0.02 * w]]
    T = np.linalg.qr(rng.standard_normal((states, states)))[0]
    B, C = rng.standard_normal((states, CHANNELS)), rng.standard_normal((CHANNELS, states))
    return StateSpace(T @ A @ T.T, T @ B, C @ T.T, np.zeros((CHANNELS, CHANNELS)))


def timed(G: StateSpace, order: int, repeats: int) -> tuple[StateSpace, float]:
    """Return the reduced system and the least processor time of some runs."""
    spent, result = [], None
    for _ in range(repeats):
        started = time.process_time()
        result = Balanced(states=order).reduce(G)
        spent.append(time.process_time() - started)
    assert result is not None
    return result.controller, min(spent)


def error(G: StateSpace, reduced: StateSpace) -> float:
    """Return the H-infinity norm of the difference."""
    minus = StateSpace(reduced.A, reduced.B, -reduced.C, -reduced.D)
    return hinf_norm(parallel(G, minus))[0]
