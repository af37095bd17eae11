"""Box-Jenkins fits beside sippy_unipi, the only other open package that has the structure, on the easy truth."""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from benchmarks import _peer
from benchmarks.identify_matrix import records
from ultraquiet._base.threads import in_threads
from ultraquiet.linalg import prediction

PEER = ("sippy_unipi==1.0.1",)
FITS, PEER_FITS, TIMES_FASTER, ORDER = 36, 2, 300.0, 5


def measure() -> Iterator[tuple[str, str, str, bool]]:
    data = records(np.random.default_rng(), FITS, "easy")
    method = uq.identify.BoxJenkins(order=ORDER)
    method.identify(data[0][0])
    started = time.perf_counter()
    found = in_threads("fits", lambda k: method.identify(data[k][0]), range(FITS), None)
    seconds = time.perf_counter() - started
    what, target = f"{FITS} fifth-order Box-Jenkins fits of the easy truth against sippy_unipi", f"{TIMES_FASTER:g} x"
    try:
        left = beside([data[k][0] for k in range(PEER_FITS)])
    except _peer.PeerError as why:
        yield what, f"not measured: {why}", target, False
        return
    each = [float(left[f"seconds_{k}"]) for k in range(PEER_FITS)]
    faster = FITS * float(np.mean(each)) / seconds
    took = ", ".join(f"{s:.1f}" for s in each)
    figure = f"{faster:.0f} x: {seconds:.2f} s on {os.cpu_count()} cores; {PEER_FITS} of its fits took {took} s on one"
    yield f"{what}, its time scaled to {FITS}", figure, target, faster >= TIMES_FASTER
    losses = [(found[k].loss[0], peer_loss(data[k][0], left, k)) for k in range(PEER_FITS)]
    figure = ", ".join(f"{ours:.5g} / {theirs:.5g}" for ours, theirs in losses)
    kept = all(ours <= 1.001 * theirs for ours, theirs in losses)
    yield "mean squared one-step residual, ours / theirs", figure, "no larger", kept


def beside(chosen: list[uq.Record]) -> dict[str, np.ndarray]:
    """Return seconds and coefficients of the peer's fits."""
    python = _peer.environment("sippy", PEER)
    given = {
        "u": np.stack([r.inputs[0] for r in chosen]),
        "y": np.stack([r.outputs[0] for r in chosen]),
        "order": np.array(ORDER),
    }
    with tempfile.TemporaryDirectory() as folder:
        return _peer.run(python, "_sippy.py", given, Path(folder))


def peer_loss(record: uq.Record, left: dict[str, np.ndarray], k: int) -> float:
    """Judge the peer's model as ours are judged: past before the record fitted, infinite when C or F is unstable."""
    b, f, c, d = (left[f"{name}_{k}"] for name in "bfcd")
    if any(np.abs(np.roots(p)).max(initial=0.0) >= 1.0 for p in (f, c)):
        return float("inf")
    e = prediction.innovations(record.inputs, record.outputs[0], np.ones(1), [b], [f], c, d)
    return float(np.mean(e**2))
