"""Resonators round the packaged study's quiet law, as their compiled code: tones of 10 V, then noise, then jumps.

Tones are sent to all actuators, one after the other and all at once (10 V together), for 20 s, hysteresis on; what
counts is the worst channel over the second half. After a jump an adaptive layer round the quiet law follows; of that
counts the second from 0.5 s after the jump on. ULTRAQUIET_DEMO names the folder of a study walked before.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from benchmarks.law_levels import law as quiet_law
from benchmarks.quiet_law import BAND_HZ, UNITS, plants
from ultraquiet.design import AdaptiveFeedforward, Resonators

TONES_HZ, VOLTS, SECONDS = (5.0, 25.0, 100.0), 10.0, 20.0
EACH_DB, TOGETHER_DB, QUIET_DB, PEAK_DB = 40.0, 38.0, 20.0, 6.5
JUMP_HZ, JUMP_DB, BEFORE_S, FOLLOWED_S, HEARD_S = 2.0, 30.0, 6.0, 0.5, 1.0
SPANS, BESIDE_HZ = {5.0: 0.45, 25.0: 0.1, 100.0: 0.05}, 3.0  # wide enough for the jump; of a spectrum, to each side
# A tone is followed as fast as its frequency is, which noise allows for one so loud; at 5 Hz amplitudes are slow.
TRACK_HZ, FIND_S = {5.0: 1.0, 25.0: 5.0, 100.0: 8.0}, 0.25

# at 5 Hz geophones hear next to nothing: what follows must not be as loud above
BANK = {"tones_hz": TONES_HZ, "settling_s": (4.0, 2.0, 5.0), "loop_peak_db": 6.0, "roll_off": 2.0}

Row = tuple[str, str, str, bool]


def laws(seed: int) -> tuple[uq.StateSpace, uq.StateSpace, uq.StateSpace]:
    """Return the model of the ground unit, the quiet law, and the law for tones round it."""
    model, quiet = plants(seed)[0], quiet_law(seed)
    law = Resonators(**BANK, around=quiet).design(model).controller
    assert law is not None
    return model, quiet, law


def measure() -> Iterator[Row]:
    seed = int(np.random.default_rng().integers(2**30))
    print(f"# seed {seed}", flush=True)
    model, quiet, law = laws(seed)
    with tempfile.TemporaryDirectory() as folder:
        for unit in UNITS:
            bench = uq.bench.Hexapod(unit=unit, seed=seed, hysteresis=True)
            limits = [channel.high for channel in bench.actuators]
            code = uq.deploy.generate(law, Path(folder) / unit, "float32", limits_v=limits).instance()
            yield from _tones(unit, bench, code)
            read = uq.simulate.measure_sensitivity(bench, code)
            worst, peak = read.worst_in_band_db(*BAND_HZ), read.peak_amplification_db()
            yield f"{unit}: broadband, worst direction", f"{worst:.2f} dB", f"{QUIET_DB:g} dB", worst >= QUIET_DB
            yield f"{unit}: broadband, peak", f"{peak:.2f} dB", f"{PEAK_DB:g} dB", peak <= PEAK_DB
            yield from _jumps(unit, bench, model, quiet)


def _tones(unit: str, bench, code) -> Iterator[Row]:
    each = uq.simulate.attenuation(bench, code, TONES_HZ, VOLTS, SECONDS).worst_reduction_db
    for tone, db in zip(TONES_HZ, each, strict=True):
        yield f"{unit}: {tone:g} Hz alone", f"{db:.1f} dB", f"{EACH_DB:g} dB", bool(db >= EACH_DB)
    t = np.arange(round(SECONDS * bench.rate_hz)) / bench.rate_hz
    sum_of = sum(np.sin(2 * np.pi * f * t) for f in TONES_HZ)
    d = np.tile(VOLTS / len(TONES_HZ) * sum_of, (len(bench.actuators), 1))
    opened, closed = (bench.run(0 * d, disturbance=d, controller=each) for each in (None, code))
    half = slice(t.size // 2, None)  # whole periods of all three
    for tone in TONES_HZ:
        turn = np.exp(-2j * np.pi * tone * t[half])
        sizes = [np.abs((run.outputs[:, half] * turn).mean(axis=1)) for run in (opened, closed)]
        db = float(20 * np.log10(sizes[0] / sizes[1]).min())
        yield f"{unit}: {tone:g} Hz, all three at once", f"{db:.1f} dB", f"{TOGETHER_DB:g} dB", db >= TOGETHER_DB


def _jumps(unit: str, bench, model: uq.StateSpace, quiet: uq.StateSpace) -> Iterator[Row]:
    rate = bench.rate_hz
    t = np.arange(round((BEFORE_S + FOLLOWED_S + HEARD_S) * rate)) / rate
    heard = slice(round((BEFORE_S + FOLLOWED_S) * rate), None)
    for tone in TONES_HZ:
        how = {"track_hz": TRACK_HZ[tone], "find_s": FIND_S, "peak_db": 10.0, "loop_peak_db": PEAK_DB}
        method = AdaptiveFeedforward((tone,), SPANS[tone], around=quiet, **how)
        law = method.design(model).law
        worst = np.inf
        for jump in (-JUMP_HZ, JUMP_HZ):
            f_hz = np.where(t < BEFORE_S, tone, tone + jump)
            d = np.tile(VOLTS * np.sin(2 * np.pi * np.cumsum(f_hz) / rate), (len(bench.actuators), 1))
            runs = [bench.run(0 * d, disturbance=d, controller=each) for each in (None, law)]
            sizes = [_beside(run.outputs[:, heard], tone + jump, rate) for run in runs]
            worst = min(worst, float(20 * np.log10(sizes[0] / sizes[1]).min()))
        name = f"{unit}: {tone:g} Hz jumps by {JUMP_HZ:g} Hz, from {FOLLOWED_S:g} s on"
        yield name, f"{worst:.1f} dB", f"{JUMP_DB:g} dB", law is not None and worst >= JUMP_DB


def _beside(y: np.ndarray, f_hz: float, rate_hz: float) -> np.ndarray:
    """Return the size of the spectrum round a tone, `(ny,)`."""
    f = np.fft.rfftfreq(y.shape[1], 1 / rate_hz)
    near = np.abs(f - f_hz) <= BESIDE_HZ
    return np.linalg.norm(np.fft.rfft(y * np.hanning(y.shape[1]))[:, near], axis=1)
