"""The sampled loop against the multiply-adds it cannot do without, and a campaign of a hundred seeds."""

import os
import time
from collections.abc import Callable, Iterator

import numba
import numpy as np

import ultraquiet as uq
from ultraquiet.values.controller import SteppedController

SECONDS, STATES, LIMIT_S = 10.0, 60, 1.0
# How many times longer than its bare multiply-adds the loop may take: noise, limits, plays, converter and the record
# come on top.
MOST_FLOORS = 2.5
QUICKER = 4.0  # than one step of plant and law after the other, of large ones; small ones are thirty times as quick
RUNS, CAMPAIGN_SAMPLES, CAMPAIGN_LIMIT_S = 100, 4096, 5.0


@numba.njit(fastmath=False)
def plain_products(Mt, x, samples):
    """Multiply one matrix by a vector over and over: nothing but multiply-adds along memory."""
    y = np.zeros(Mt.shape[1])
    for _ in range(samples):
        y[:] = 0.0
        for j in range(Mt.shape[0]):
            value = x[j]
            for i in range(Mt.shape[1]):
                y[i] += Mt[j, i] * value
        x[0] = 1e-3 * y[0]
    return y


def law_of(rng: np.random.Generator, sensors: int, actuators: int) -> uq.StateSpace:
    """A stable law of STATES states with small gains."""
    A = 0.9 * np.linalg.qr(rng.standard_normal((STATES, STATES)))[0]
    B, C = 1e-3 * rng.standard_normal((STATES, sensors)), 1e-3 * rng.standard_normal((actuators, STATES))
    return uq.StateSpace(A, B, C, np.zeros((actuators, sensors)), 3500.0)


def multiply_adds(bench: uq.bench.Hexapod, law: uq.StateSpace) -> int:
    """Multiply-adds of one sample: plant, plays and law, each matrix once."""
    A, B, C = bench.model.sampled
    plays = 6 * bench._matrices(20.0)[4].size
    return A.size + B.size + C.size + plays + law.A.size + law.B.size + law.C.size + law.D.size


def least(work: Callable[[], object], times: int = 5) -> float:
    """Return the least seconds of processor time: what others do on the machine does not count."""
    spent = []
    for _ in range(times):
        started = time.process_time()
        work()
        spent.append(time.process_time() - started)
    return min(spent)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng = np.random.default_rng()
    for instruments in ("struts", "all"):
        bench = uq.bench.Hexapod(unit="flight", hysteresis=True, instruments=instruments)
        nu, ny = len(bench.actuators), len(bench.sensors)
        law = law_of(rng, ny, nu)
        u = rng.standard_normal((nu, int(SECONDS * bench.rate_hz)))
        bench.run(u[:, :100], controller=law)
        seconds = least(lambda b=bench, u=u, k=law: b.run(u, controller=k))
        count = multiply_adds(bench, law)
        # As long as the plant's own columns, as many of them as make up the count.
        n = len(bench.model.sampled[0])
        M, x = rng.standard_normal((round(count / n), n)), rng.standard_normal(round(count / n))
        plain_products(M, x, 10)
        floor = least(lambda M=M, x=x, n=u.shape[1]: plain_products(M, x, n))
        what = f"{SECONDS:g} s of flight unit, {nu} x {ny} channels, hysteresis, {STATES}-state law"
        yield what, f"{seconds:.3f} s of one core", f"under {LIMIT_S:g} s", seconds < LIMIT_S
        what = f"the same, against its {count} multiply-adds a sample ({floor:.3f} s)"
        yield what, f"{seconds / floor:.2f} x floor", f"under {MOST_FLOORS:g} x", seconds < MOST_FLOORS * floor
    yield from _models(rng)
    yield from _campaign(rng)


class Asked(SteppedController):
    """A law that a bench asks sample by sample."""


def _models(rng: np.random.Generator) -> Iterator[tuple[str, str, str, bool]]:
    """Yield how much quicker a model runs with its law as one than each asked in turn."""
    for ny, nu, states in ((1, 1, 4), (4, 3, 12), (6, 6, 132)):
        A = 0.9 * np.linalg.qr(rng.standard_normal((states, states)))[0]
        B, C = rng.standard_normal((states, nu)), 1e-3 * rng.standard_normal((ny, states))
        bench = uq.bench.LinearBench(uq.StateSpace(A, B, C, np.zeros((ny, nu)), 3500.0))
        law, u = law_of(rng, ny, nu), rng.standard_normal((nu, 20000))
        asked, as_one = (least(lambda b=bench, u=u, k=k: b.run(u, controller=k), 3) for k in (Asked(law), law))
        what = f"a model of {ny} x {nu} channels, {states} states, {STATES}-state law: as one"
        figure = f"{asked / as_one:.1f} x as fast as each asked in turn"
        yield what, figure, f"{QUICKER:g} x", asked >= QUICKER * as_one


def _campaign(rng: np.random.Generator) -> Iterator[tuple[str, str, str, bool]]:
    bench = uq.bench.Hexapod(unit="flight", hysteresis=True, spread=1.0)
    law, u = law_of(rng, 6, 6), rng.standard_normal((6, CAMPAIGN_SAMPLES))
    bench.campaign(range(2), u, controller=law)
    for own_units in (False, True):
        first = int(rng.integers(2**31))
        started = time.perf_counter()
        records = bench.campaign(range(first, first + RUNS), u, controller=law, own_units=own_units)
        seconds = time.perf_counter() - started
        different = len({r.hash for r in records}) == RUNS
        what = f"{RUNS} runs of {CAMPAIGN_SAMPLES} samples, law in the loop, {'own units' if own_units else 'one unit'}"
        figure = f"{seconds:.2f} s on {os.cpu_count()} cores"
        yield what, figure, f"under {CAMPAIGN_LIMIT_S:g} s, all different", seconds < CAMPAIGN_LIMIT_S and different
