"""A plant of 24 inputs, 24 outputs and 240 lightly damped states: a mixed-sensitivity design and its law's reduction.

Each figure is that of a process of its own: the seconds of the call by the clock, those of its processor (on a quiet
machine the same, for nothing here runs side by side), and the largest resident size that the system counted, Python and
libraries included.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from ultraquiet.values import StateSpace

STATES, CHANNELS, RATE_HZ = 240, 24, 3500.0
SLOWEST_HZ, FASTEST_HZ = 5.0, 1000.0
DAMPING = (0.005, 0.02)
BAND_HZ = (9.0, 108.0)
KEPT = 144  # states of the reduced law
DESIGN_S, BAND_S, REDUCTION_S, DESIGN_MB = 30.0, 30.0, 40.0, 600.0

PROBE = """
import json, os, resource, sys, time
for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(library + "_NUM_THREADS", "1")
import ultraquiet as uq
from benchmarks.many_channels import drawn
seed, band_hz, kept = json.loads(sys.argv[1])
plant = drawn(seed)
begun, busy = time.perf_counter(), time.process_time()
result = uq.design.MixedSensitivity(band_hz=band_hz and tuple(band_hz)).design(plant)
seconds, mb = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
busy = time.process_time() - busy
found = {"word": str(result.status.word.value), "gain": result.details.get("gain"), "seconds": seconds, "mb": mb}
found["busy"] = busy
if kept and result.controller is not None:
    begun, busy = time.perf_counter(), time.process_time()
    reduced = uq.reduce.ClosedLoopWeighted(states=kept).reduce(result.controller, plant)
    found |= {"reduction": time.perf_counter() - begun, "states": reduced.controller.states}
    found |= {"reduced_word": str(reduced.status.word.value), "reduction_busy": time.process_time() - busy}
    found |= {"enough": reduced.details.get("enough", kept)}
print(json.dumps(found))
"""


def drawn(seed: int) -> StateSpace:
    """Return the plant: modes spread evenly over the logarithm of frequency, every one in all channels."""
    rng = np.random.default_rng(seed)
    pairs = STATES // 2
    f_hz = np.exp(rng.uniform(np.log(SLOWEST_HZ), np.log(FASTEST_HZ), pairs))
    zeta = rng.uniform(*DAMPING, pairs)
    poles = np.exp(2 * np.pi * f_hz * (-zeta + 1j * np.sqrt(1 - zeta**2)) / RATE_HZ)
    A = np.zeros((STATES, STATES))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    size = np.repeat(np.sqrt(1 - np.abs(poles)), 2)
    B = size[:, None] * rng.standard_normal((STATES, CHANNELS))
    C = rng.standard_normal((CHANNELS, STATES)) * size
    return StateSpace(A, B, C, np.zeros((CHANNELS, CHANNELS)), rate_hz=RATE_HZ)


def probe(seed: int, band_hz: tuple[float, float] | None, kept: int = 0) -> dict[str, Any]:
    """Design, and reduce where states are to be kept, in a process of its own."""
    given = json.dumps([seed, band_hz, kept])
    done = subprocess.run([sys.executable, "-c", PROBE, given], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(done.stdout)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    seed = int(np.random.default_rng().integers(2**31))
    size = f"{CHANNELS} x {CHANNELS}, {STATES} states"
    whole = probe(seed, None, KEPT)
    for what, found, limit_s in (
        ("without a band", whole, DESIGN_S),
        (f"{BAND_HZ[0]:g}-{BAND_HZ[1]:g} Hz", probe(seed, BAND_HZ), BAND_S),
    ):
        spent = f"{found['seconds']:.1f} s ({found['busy']:.1f} s busy), {found['mb']:.0f} MB"
        figure = f"{spent}, {found['word']} at gain {found['gain']}, seed {seed}"
        kept = found["seconds"] <= limit_s and found["mb"] <= DESIGN_MB and found["word"] == "ok"
        yield f"mixed sensitivity, {size}, {what}", figure, f"<= {limit_s:g} s, {DESIGN_MB:g} MB, ok", kept
    if "reduction" not in whole:
        yield f"its law to {KEPT} states", "there is no law", f"<= {REDUCTION_S:g} s", False
        return
    spent = f"{whole['reduction']:.1f} s ({whole['reduction_busy']:.1f} s busy)"
    figure = f"{spent}, {whole['states']} states, {whole['reduced_word']}, {whole['enough']} keep every promise"
    stable = whole["reduced_word"] != "unstable"
    kept = whole["reduction"] <= REDUCTION_S and whole["states"] <= KEPT and stable
    yield f"its law to {KEPT} states", figure, f"<= {REDUCTION_S:g} s, the loop stable", kept
