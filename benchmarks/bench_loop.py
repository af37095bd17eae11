"""The sampled loop against the multiply-adds it cannot do without."""

import time
from collections.abc import Iterator

import numpy as np

import ultraquiet as uq

SECONDS, STATES, LIMIT_S = 10.0, 60, 1.0


def measure() -> Iterator[tuple[str, str, str, bool]]:
    bench = uq.bench.Hexapod(unit="flight", hysteresis=True)
    rng = np.random.default_rng()
    A = 0.9 * np.linalg.qr(rng.standard_normal((STATES, STATES)))[0]
    law = uq.StateSpace(
        A, 1e-3 * rng.standard_normal((STATES, 6)), 1e-3 * rng.standard_normal((6, STATES)), np.zeros((6, 6)), 3500.0
    )
    u = rng.standard_normal((6, int(SECONDS * bench.rate_hz)))
    bench.run(u[:, :100], controller=law)
    times = []
    for _ in range(5):
        started = time.perf_counter()
        bench.run(u, controller=law)
        times.append(time.perf_counter() - started)
    seconds = float(np.median(times))
    n = bench.linear_model().states
    floor = u.shape[1] * (n * n + 2 * 6 * n + STATES * STATES + 12 * STATES)
    # One core's own speed at multiply-adds of this kind, measured here: the ratio then holds on any machine.
    M, x = rng.standard_normal((n + STATES, n + STATES)), rng.standard_normal(n + STATES)
    started = time.perf_counter()
    for _ in range(20000):
        x = 0.01 * (M @ x)
    each = (time.perf_counter() - started) / (20000 * M.size)
    what = f"{SECONDS:g} s of flight unit, hysteresis, {STATES}-state law in the loop"
    yield what, f"{seconds:.2f} s, {seconds / (floor * each):.1f} x floor", f"under {LIMIT_S:g} s", seconds < LIMIT_S
