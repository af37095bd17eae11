"""A 36-channel Box-Jenkins array of 180 states straight from identification: designed, reduced, closed again.

The records excite the bench up to 1.5 kHz: a law of a 3.5 kHz loop acts on all frequencies up to half of that, and
what a record does not hold no model can tell. Losses are computed here again, from the reduced matrices alone.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

import ultraquiet as uq
from ultraquiet.analyse import h2_norm, hinf_norm
from ultraquiet.values.interconnect import feedback, lft

SEEDS, SAMPLES, EXCITED_HZ, PEAK_V = 5, 8192, 1500.0, 10.0
HINF_STATES, HINF_LOSS, LQG_STATES, LQG_LOSS = 36, 0.05, 24, 0.01
# The default's weights bring 60 states of their own; to 36 states it loses 4.6 to 7.4 %, depending on the array.
WEIGHTS = {"band_hz": (9.0, 108.0), "height": 12.0}
DEFAULT_STATES = 42
NORMS = {"peak": lambda loop: hinf_norm(loop)[0], "mean-square": h2_norm}
# The four-block with weights of order 8, the same with two states a channel (198 + 6 states), LQG of the paper's
# section 4.2 (white disturbance at the inputs, no weights: 180 states).
DESIGNS: tuple[tuple[str, Any, str, int, float], ...] = (
    (
        "H-infinity, four-block, weights of order 8",
        uq.design.MixedSensitivity(**WEIGHTS),
        "peak",
        DEFAULT_STATES,
        HINF_LOSS,
    ),
    (
        "H-infinity, weights of order 2",
        uq.design.MixedSensitivity(**WEIGHTS, order=2),
        "peak",
        HINF_STATES,
        HINF_LOSS,
    ),
    (
        "LQG, disturbance at the inputs",
        uq.design.Lqg(control_weight=1e-8, disturbance_at="input"),
        "mean-square",
        LQG_STATES,
        LQG_LOSS,
    ),
)


def array(seed: int) -> uq.StateSpace:
    """Identify 36 fifth-order models from six records of the simulated bench."""
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    noise = uq.signals.BandLimitedNoise(stop_hz=EXCITED_HZ, peak_v=PEAK_V)
    records = []
    for k in range(6):
        u = np.zeros((6, SAMPLES))
        u[k] = noise.generate(samples=SAMPLES, rate_hz=bench.rate_hz, seed=seed + k)
        records.append(bench.run(u))
    return uq.identify.identify_matrix(uq.identify.BoxJenkins(order=5), records).state_space()


def judged_by(method: Any, plant: uq.StateSpace) -> uq.StateSpace:
    """Return the generalised plant that a design minimises over."""
    if isinstance(method, uq.design.Lqg):
        return method.generalised(plant)
    return method.generalised(plant, method.weights(plant))


def reduced(method: Any, plant: uq.StateSpace, norm: str, states: int, allowed: float) -> tuple[int, float, float]:
    """Design, reduce and close the loop again; return the full size, the loss and the seconds of the reduction."""
    result = method.design(plant)
    if result.controller is None:
        return 0, np.inf, np.nan
    P = judged_by(method, plant)
    started = time.process_time()
    small = uq.reduce.ClosedLoopWeighted(states=states, loss=allowed, norm=norm).reduce(result.controller, plant, P)
    seconds = time.process_time() - started
    K = uq.StateSpace(small.controller.A, small.controller.B, small.controller.C, small.controller.D, plant.rate_hz)
    if not feedback(plant, K).is_stable() or states < K.states:
        return result.controller.states, np.inf, seconds
    return result.controller.states, NORMS[norm](lft(P, K)) / NORMS[norm](lft(P, result.controller)) - 1, seconds


def measure() -> Iterator[tuple[str, str, str, bool]]:
    spread: dict[str, list[float]] = {name: [] for name, *_ in DESIGNS}
    for number, seed in enumerate(np.random.SeedSequence().generate_state(SEEDS), start=1):
        plant = array(int(seed))
        for name, method, norm, states, allowed in DESIGNS:
            size, loss, seconds = reduced(method, plant, norm, states, allowed)
            spread[name].append(100 * loss)
            what = f"array {number}: {name}, {size} -> {states}, {norm} norm"
            yield what, f"{100 * loss:+.2f} % in {seconds:.1f} s", f"at most {100 * allowed:g} %", loss <= allowed
    for name, _, _, _, allowed in DESIGNS:
        low, high = min(spread[name]), max(spread[name])
        figure = f"{low:+.2f} to {high:+.2f} %"
        yield f"{name}, {SEEDS} arrays", figure, f"at most {100 * allowed:g} %", high <= 100 * allowed
