"""An hour of twelve channels, read in blocks: seconds and memory of all cross spectra and the MIMO response."""

import time
import tracemalloc
from collections.abc import Iterator

import numpy as np

import ultraquiet as uq

RATE_HZ, SECONDS, BLOCK_S = 3500.0, 3600, 10
INPUTS = OUTPUTS = 6
SEGMENT = 4096
# A recording must be digested sixty times faster than it was made, and held no larger than a few of its matrices.
LIMIT_S, LIMIT_MB = 60.0, 150.0


def recording(seconds: int) -> Iterator[uq.Record]:
    rng = np.random.default_rng()
    gains = rng.standard_normal((OUTPUTS, INPUTS))
    n = int(BLOCK_S * RATE_HZ)
    u = rng.standard_normal((INPUTS, n))
    noise = rng.standard_normal((OUTPUTS, n))
    for _ in range(seconds // BLOCK_S):
        shift = int(rng.integers(n))
        v = np.roll(u, shift, axis=1)
        yield uq.Record(v, gains @ v + 0.1 * noise, RATE_HZ)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    started = time.perf_counter()
    for _ in recording(SECONDS):
        pass
    making = time.perf_counter() - started
    started = time.perf_counter()
    cross = uq.spectra.cross_spectra(recording(SECONDS), SEGMENT)
    response = uq.spectra.frf(cross)
    seconds = time.perf_counter() - started - making
    # The transforms alone, at this machine's speed: what no way of averaging can do without.
    x = np.random.default_rng().standard_normal((INPUTS + OUTPUTS, 32, SEGMENT))
    begun = time.perf_counter()
    for _ in range(4):
        np.fft.rfft(x)
    floor = (time.perf_counter() - begun) / (4 * 32) * cross.averaging.averages
    what = f"{SECONDS} s, {INPUTS + OUTPUTS} channels at {RATE_HZ:g} Hz, {cross.averaging.averages} segments"
    measured = f"{seconds:.1f} s, {seconds / floor:.1f} x the transforms"
    yield what, measured, f"under {LIMIT_S:g} s", seconds < LIMIT_S and np.isfinite(response.values).all()
    tracemalloc.start()
    uq.spectra.cross_spectra(recording(120), SEGMENT)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    yield "most memory held, blocks of 10 s included", f"{peak:.0f} MB", f"under {LIMIT_MB:g} MB", peak < LIMIT_MB
