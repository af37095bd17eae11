"""Box-Jenkins fits of the known truth at 3.5 kHz: a whole matrix, in seconds of its own processors."""

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet.linalg.prediction import fit_percent

TRUTHS = Path(__file__).parents[1] / "tests" / "data" / "known_truths.json"
LIMIT_S, MOST_STEPS, SAME_LOSS = 1.0, 0.5, 1.02


def records(rng: np.random.Generator, count: int, name: str = "suite_rate") -> list[tuple[uq.Record, np.ndarray]]:
    """Fresh records of a truth, each with its output before noise."""
    truth = json.loads(TRUTHS.read_text())[name]
    rate, n = truth["rate_hz"], truth["samples"]

    def polynomial(part: dict) -> np.ndarray:
        roots = [np.exp(2 * np.pi * f / rate * (-z + 1j * np.sqrt(1 - z * z))) for f, z in part["modes"]]
        reals = [np.exp(-2 * np.pi * f / rate) for f in part["reals"]]
        return np.poly([*roots, *np.conj(roots), *reals]).real

    from scipy.signal import lfilter

    b, f, c, d = (polynomial(truth[k]) for k in "BFCD")
    out = []
    for _ in range(count):
        u = rng.standard_normal(n)
        w = lfilter(np.r_[0.0, b], f, u)
        e = lfilter(c, d, rng.standard_normal(n + 20000))[20000:]
        w /= w.std()
        out.append((uq.Record(u, w + 10 ** (-truth["snr_db"] / 20) * e / e.std(), rate), w))
    return out


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng, cores = np.random.default_rng(), os.cpu_count() or 1
    method = uq.identify.BoxJenkins(order=5)
    from ultraquiet._base.threads import in_threads

    data = records(rng, 36)
    method.identify(data[0][0])
    started, spent = time.perf_counter(), time.process_time()
    found = in_threads("fits", lambda k: method.identify(data[k][0]), range(36), None)
    seconds, processor = time.perf_counter() - started, time.process_time() - spent
    fits = [fit_percent(w, found[k].state_space().simulate(r.inputs)[0]) for k, (r, w) in enumerate(data)]
    median = float(np.median(fits))
    yield (
        "36 fifth-order Box-Jenkins fits, 4096 samples, 3.5 kHz truth",
        f"{seconds:.2f} s, {processor:.2f} s of {cores} processors",
        f"under {LIMIT_S:g} s",
        seconds < LIMIT_S,
    )
    yield "their median simulated fit to the output before noise", f"{median:.1f} %", "at least 95 %", median >= 95
    fresh = [r for r, _ in records(rng, 36)]
    again = in_threads("refits", lambda k: method.identify(fresh[k], start=found[k].model), range(36), None)
    anew = in_threads("fits", lambda k: method.identify(fresh[k]), range(36), None)
    ratio = sum(again[k].iterations[0] for k in again) / sum(anew[k].iterations[0] for k in anew)
    worse = max(again[k].loss[0] / anew[k].loss[0] for k in again)
    figure = f"{ratio:.2f} of the steps, loss {worse:.3f}"
    yield (
        "refits of fresh records from the last model, most loss against anew",
        figure,
        "0.5, 1.02",
        (ratio <= MOST_STEPS and worse <= SAME_LOSS),
    )
