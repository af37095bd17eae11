"""H-infinity synthesis on synthetic 6 x 6 arrays: the same optimum in any units, speed, and SLICOT beside it."""

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _peer
from ultraquiet.analyse import hinf_norm
from ultraquiet.design import DesignResult, band_pass, high_pass, synthesize_hinf
from ultraquiet.design.hinf import riccati as kernel
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import lft

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "design"))
from named_plants import array_like, array_problem, closed_poles

PEER = ("slycot==0.7.1", "control==0.10.2")
MODES, FORMS = {66: 27, 120: 54, 180: 84}, ("S/KS", "four-block")
SAME, AGREEMENT, SECONDS, TIMES_SLICOT, TIMES_MIXSYN = 5e-3, 1e-3, 2.5, 2.0, 20.0
PEER_TOLERANCE = 1e-3  # of gamma: a hundred times coarser than ours, in the peer's favour
START = 2.0  # times the optimum, where the peer's bisection begins
REPEATS = 2


def measure() -> Iterator[tuple[str, str, str, bool]]:
    seed = int(np.random.SeedSequence().entropy % 2**32)  # pyright: ignore[reportOperatorIssue]
    found: dict[tuple[int, str], tuple[StateSpace, DesignResult, float]] = {}
    for states, modes in MODES.items():
        for form in FORMS:
            both = [one(seed, modes, form, raw) for raw in (False, True)]
            found[states, form] = both[0]
            yield from judged(f"{states} + 18 states, {form}, seed {seed}", both)
    for form in FORMS:
        P, _, seconds = found[180, form]
        seconds = min([seconds] + [timed(P)[1] for _ in range(REPEATS - 1)])
        figure = f"{seconds:.2f} s of one core"
        yield (
            f"{P.states} states, {form}: synthesis with its verification",
            figure,
            f"< {SECONDS:g} s",
            seconds < SECONDS,
        )
    yield from beside_slicot({form: found[180, form] for form in FORMS})
    yield from beside_mixsyn(array_like(np.random.default_rng(seed), MODES[66]), found[66, "S/KS"][1])


def one(seed: int, modes: int, form: str, raw: bool) -> tuple[StateSpace, DesignResult, float]:
    P = array_problem(form, array_like(np.random.default_rng(seed), modes, raw), raw)
    return P, *timed(P)


def timed(P: StateSpace) -> tuple[DesignResult, float]:
    """Return the result and the seconds of processor time: what it takes on a core that has nothing else to do."""
    started = time.process_time()
    result = synthesize_hinf(P, 6, 6)
    return result, time.process_time() - started


def judged(what: str, both: list[tuple[StateSpace, DesignResult, float]]) -> Iterator[tuple[str, str, str, bool]]:
    if not all(r.status.ok for _, r, _ in both):
        yield what, "; ".join(str(r.status) for _, r, _ in both), "a controller", False
        return
    one, other = (r.gamma for _, r, _ in both)
    apart = abs(other / one - 1)
    yield f"{what}: gamma modal / raw", f"{one:.5f} / {other:.5f}", f"{SAME:.1%}", apart <= SAME
    worst = max(abs(r.gamma / r.achieved - 1) for _, r, _ in both)
    yield f"{what}: reported against achieved", f"{worst:.1e}", f"{AGREEMENT:.1%}", worst <= AGREEMENT
    farthest = max(float(np.abs(closed_poles(P, r.controller, 6, 6)).max()) for P, r, _ in both)
    yield f"{what}: largest closed-loop pole", f"{farthest:.7f}", "< 1", farthest < 1


def beside_slicot(found: dict[str, tuple[StateSpace, DesignResult, float]]) -> Iterator[tuple[str, str, str, bool]]:
    """SB10AD, job 1 (bisection), on the continuous problem in normalised modal coordinates."""
    given: dict[str, Any] = {"names": " ".join(found), "repeats": 1}
    for form, (P, ours, _) in found.items():
        given |= {f"{form}_{k}": m for k, m in zip("ABCD", best_coordinates(P), strict=True)}
        given |= {f"{form}_controls": 6, f"{form}_measurements": 6}
        given |= {f"{form}_start": START * ours.gamma, f"{form}_tolerance": PEER_TOLERANCE * ours.gamma}
    target = f"{TIMES_SLICOT:g} x"
    try:
        left = run("_slycot.py", given)
    except _peer.PeerError as why:
        yield "198 states against SLICOT SB10AD", f"not measured: {why}", target, False
        return
    for form, (P, ours, before) in found.items():
        seconds = min(before, timed(P)[1])
        theirs, gamma = float(left[f"{form}_seconds"]), float(left[f"{form}_gamma"])
        true = hinf_norm(lft(StateSpace(*best_coordinates(P)), StateSpace(*(left[f"{form}_{k}"] for k in "ABCD"))))[0]
        figure = f"{theirs / seconds:.1f} x: {seconds:.2f} s, gamma {ours.gamma:.5f}; it {theirs:.2f} s, "
        figure += f"reported {gamma:.5f}, true {true:.5f}"
        yield f"{P.states} states, {form}, against SLICOT SB10AD", figure, target, theirs / seconds >= TIMES_SLICOT


def best_coordinates(P: StateSpace) -> tuple[np.ndarray, ...]:
    plant = kernel.normalise(bilinear_to_continuous(P.A, P.B, P.C, P.D), 6, 6)
    D12, D21 = kernel.direct_terms(plant)
    D = np.block([[plant.D11, D12], [D21, np.zeros((6, 6))]])
    return plant.A, np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2]), D


def beside_mixsyn(plant: StateSpace, ours: DesignResult) -> Iterator[tuple[str, str, str, bool]]:
    """The same S/KS problem, plant and weights brought to continuous time by the same map."""
    on_y, on_u = band_pass((9, 108), 10.0, 0.5, 2, 3500.0, 6), high_pass(400.0, 1e-2, 1e-1, 1, 3500.0, 6)
    given = {
        f"{name}_{k}": m
        for name, s in (("plant", plant), ("on_s", on_y), ("on_ks", on_u))
        for k, m in zip("ABCD", bilinear_to_continuous(s.A, s.B, s.C, s.D), strict=True)
    }
    what, target = "84 states, S/KS, against python-control's mixsyn", f"{TIMES_MIXSYN:g} x"
    try:
        left = run("_mixsyn.py", given)
    except _peer.PeerError as why:
        yield what, f"not measured: {why}", target, False
        return
    seconds = min(timed(array_problem("S/KS", plant))[1] for _ in range(REPEATS))
    theirs = float(left["seconds"])
    figure = f"{theirs / seconds:.0f} x: {seconds:.2f} s, gamma {ours.gamma:.4f}; it {theirs:.1f} s, "
    figure += f"reported {float(left['gamma']):.4f}, true {its_norm(plant, left):.4f}"
    yield what, figure, target, theirs / seconds >= TIMES_MIXSYN


def its_norm(plant: StateSpace, left: dict[str, np.ndarray]) -> float:
    """Return what its controller (of negative feedback) achieves in the problem it was given."""
    P = array_problem("S/KS", plant)
    K = StateSpace(*bilinear_to_discrete(left["A"], left["B"], -left["C"], -left["D"]), rate_hz=P.rate_hz)
    return hinf_norm(lft(P, K))[0]


def run(script: str, given: dict[str, Any]) -> dict[str, np.ndarray]:
    python = _peer.environment("slycot", PEER)
    with tempfile.TemporaryDirectory() as folder:
        return _peer.run(python, script, {k: np.asarray(v) for k, v in given.items()}, Path(folder))
