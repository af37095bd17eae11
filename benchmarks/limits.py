"""The best flat attenuation of the bench's heave from both sides, and the seconds it takes."""

import time
from collections.abc import Iterator

import numpy as np

import ultraquiet as uq

# Reached before on this plant at 6 dB and 1000 V/V by a programme of fewer functions: floors, not limits.
REACHED_BEFORE_DB = {(5, 100): 10.6, (5, 25): 13.0, (10, 100): 29.0, (20, 100): 40.0, (4.5, 5.5): 36.0}
PEAK_DB, CONTROL_GAIN, BASIS, LIMIT_S = 6.0, 1000.0, 80, 10.0
# Between what a controller reaches and what none exceeds. Deep bands are known less well, and matter less.
APART_DB = {(5, 100): 1.0, (5, 25): 1.0, (10, 100): 2.5, (20, 100): 2.5, (4.5, 5.5): 10.0}
DIRECTIONS_S = 60.0
OFF = 0.1  # relative error of the plants for which the band of the demo is bounded too


def measure() -> Iterator[tuple[str, str, str, bool]]:
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    heave = uq.design.common_mode(plant)
    for band, before in REACHED_BEFORE_DB.items():
        started = time.process_time()
        found = uq.limits.best_flat_attenuation(heave, band, PEAK_DB, control_gain=CONTROL_GAIN, basis=BASIS)
        seconds = time.process_time() - started
        what = f"heave, {band[0]:g}-{band[1]:g} Hz, {PEAK_DB:g} dB, {CONTROL_GAIN:g} V/V"
        apart = found.bound_db - found.attenuation_db
        figure = f"{found.attenuation_db:.1f} to {found.bound_db:.1f} dB"
        kept = found.attenuation_db >= before and 0 <= apart < APART_DB[band]
        yield what, figure, f"over {before:g}, {APART_DB[band]:g} dB apart", kept
        yield "the same, processor seconds", f"{seconds:.1f} s", f"under {LIMIT_S:g} s", seconds < LIMIT_S
    yield from every_plant(heave)
    started = time.process_time()
    every = uq.limits.by_direction(plant, (10.0, 100.0), PEAK_DB, control_gain=CONTROL_GAIN, basis=40)
    seconds = time.process_time() - started
    levels = np.array([[d.limit.attenuation_db, d.limit.bound_db] for d in every])
    figure = f"{levels[:, 0].min():.1f} to {levels[:, 1].min():.1f} dB, {seconds:.0f} s"
    what = "six directions of the 6 x 6 bench, 10-100 Hz: the worst"
    yield what, figure, f"under {DIRECTIONS_S:g} s", seconds < DIRECTIONS_S and bool(np.all(levels[:, 1] > 0))


def every_plant(heave: uq.StateSpace) -> Iterator[tuple[str, str, str, bool]]:
    """Peak and attenuation of every plant off by a tenth, from both sides; and how much less that is."""
    asked = {"control_gain": CONTROL_GAIN, "basis": BASIS}
    plain = uq.limits.best_flat_attenuation(heave, (10, 100), PEAK_DB, **asked)
    started = time.process_time()
    found = uq.limits.best_flat_attenuation(heave, (10, 100), PEAK_DB, uncertainty=OFF, **asked)
    seconds = time.process_time() - started
    apart = found.bound_db - found.attenuation_db
    what = f"heave, 10-100 Hz, every plant off by {100 * OFF:g} %"
    figure = (
        f"{found.attenuation_db:.1f} to {found.bound_db:.1f} dB, {plain.attenuation_db:.1f} without; {seconds:.1f} s"
    )
    kept = 0 <= apart < APART_DB[10, 100] and found.bound_db < plain.attenuation_db
    yield what, figure, f"{APART_DB[10, 100]:g} dB apart, below the plant's own", kept and seconds < LIMIT_S
