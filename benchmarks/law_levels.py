"""The packaged study's quiet law as its compiled code, driven louder and softer, on both units with hysteresis on.

In passes of 3-10, 10-20, 20-50, 50-130 and 130-1700 Hz one actuator after the other is disturbed by periodic noise, at
shares of the level at which that pass first meets a limit, in open loop and in closed. S = Y_closed Y_open^-1 at every
line. Its largest singular value s = u* S v is counted with two deviations of what noise leaves on top,

    var s = sum_ik (|u_i|^2 var Yc_ik + s^2 |v_i|^2 var Yo_ik) |w_k|^2,   w = Y_open^-1 v,

the variances from the scatter of the periods. ULTRAQUIET_DEMO names the folder of a study walked before.
"""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ultraquiet as uq
from benchmarks.quiet_law import BAND_HZ, FOLDER, LAW, UNITS, plants
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate.noise import band_noise

PASSES_HZ = ((3.0, 10.0), (10.0, 20.0), (20.0, 50.0), (50.0, 130.0), (130.0, 1700.0))
ASKED = {0.1: (19.0, 6.5), 0.4: (20.0, 6.0), 0.8: (19.0, 6.5)}
PERIOD_S, FEW, MANY, KNOWN, DEVIATIONS = 4.0, 3, 15, 0.02, 2.0
LEVELLINGS = 3

Row = tuple[str, str, str, bool]


@dataclass(frozen=True, eq=False)
class Periods:
    """Mean over the periods of a run, `(ny, lines)`, its variance, and the largest share of a limit that was used."""

    mean: np.ndarray
    variance: np.ndarray
    used: float


def law(seed: int) -> uq.StateSpace:
    """Return the law of the study that was walked before, else one designed from records made here."""
    if FOLDER in os.environ:
        return uq.files.load(Path(os.environ[FOLDER]) / "controllers" / f"{LAW}.h5")
    result = packaged_study("suite").controllers[LAW].design.make("design").design(plants(seed))
    assert result.controller is not None
    return result.controller


def listened(bench, controller, actuator: int, noise: np.ndarray, lines: np.ndarray, periods: int) -> Periods:
    """Disturb one actuator by periods of noise `(n,)`; the first one settles."""
    d = np.zeros((len(bench.actuators), noise.size * (1 + periods)))
    d[actuator] = np.tile(noise, 1 + periods)
    record = bench.run(np.zeros_like(d), disturbance=d, controller=controller)
    y = record.outputs[:, noise.size :].reshape(len(bench.sensors), periods, noise.size)
    spectra = np.fft.rfft(y, axis=2)[:, :, lines]
    variance = spectra.var(axis=1, ddof=1) / periods
    sent = [np.abs(d).max() / bench.actuators[actuator].high]
    used = [np.abs(x).max() / c.high for x, c in _channels(record)]
    return Periods(spectra.mean(axis=1), variance, max(*used, *sent))


def _channels(record: uq.Record) -> Iterator[tuple[np.ndarray, uq.Channel]]:
    yield from zip(record.outputs, record.sensors, strict=True)
    yield from zip(record.inputs, record.actuators, strict=True)


def first_clip(bench, code, actuator: int, noise: np.ndarray, lines: np.ndarray) -> float:
    """Return the level of a noise of RMS one at which a command, a reading or the disturbance meets its limit."""
    level = 1.0
    for _ in range(LEVELLINGS):  # hysteresis: what is used does not rise in proportion
        level /= max(listened(bench, each, actuator, level * noise, lines, 2).used for each in (None, code))
    return level


def sizes(bench, code, band_hz: tuple[float, float], share: float, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the lines of a pass in Hz, the largest singular value of S as it is counted, and the worst deviation."""
    n = round(PERIOD_S * bench.rate_hz)
    f = np.fft.rfftfreq(n, 1 / bench.rate_hz)
    lines = np.flatnonzero((f >= band_hz[0]) & (f <= band_hz[1]))
    noise = band_noise("law_levels", 1, n, bench.rate_hz, band_hz, seed, even=True)[0]
    levels = [share * first_clip(bench, code, k, noise, lines) for k in range(len(bench.actuators))]
    for periods in (FEW, MANY):
        opened, closed = (
            [listened(bench, each, k, level * noise, lines, periods) for k, level in enumerate(levels)]
            for each in (None, code)
        )
        s, deviation = counted(opened, closed)
        if (deviation <= KNOWN * s).all():
            break
    return f[lines], s + DEVIATIONS * deviation, float((deviation / s).max())


def counted(opened: list[Periods], closed: list[Periods]) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest singular value of S at each line and its deviation, both `(lines,)`."""
    yo, yc, vo, vc = (
        np.moveaxis(np.stack([getattr(p, part) for p in runs], axis=1), 2, 0)
        for part in ("mean", "variance")
        for runs in (opened, closed)
    )
    inverse = np.linalg.inv(yo)
    u, s, vh = np.linalg.svd(yc @ inverse)
    left, right = np.abs(u[:, :, 0]) ** 2, np.abs(vh[:, 0]) ** 2
    w = np.abs(inverse @ np.conj(vh[:, 0])[:, :, None])[:, :, 0] ** 2
    variance = np.einsum("li,lik,lk->l", left, vc, w) + s[:, 0] ** 2 * np.einsum("li,lik,lk->l", right, vo, w)
    return s[:, 0], np.sqrt(variance)


def measure() -> Iterator[Row]:
    seed = int(np.random.default_rng().integers(2**30))
    print(f"# seed {seed}", flush=True)
    linear = law(seed)
    with tempfile.TemporaryDirectory() as folder:
        for unit in UNITS:
            bench = uq.bench.Hexapod(unit=unit, seed=seed, hysteresis=True)
            limits = [channel.high for channel in bench.actuators]
            code = uq.deploy.generate(linear, Path(folder) / unit, "float32", limits_v=limits).instance()
            for share, asked in ASKED.items():
                yield from _at_level(unit, bench, code, share, asked, seed)


def _at_level(unit: str, bench, code, share: float, asked: tuple[float, float], seed: int) -> Iterator[Row]:
    quiet, loud = (np.inf, 0.0), (-np.inf, 0.0)
    for k, band in enumerate(PASSES_HZ):
        f, s, open_ = sizes(bench, code, band, share, seed + k)
        db = -20 * np.log10(s)
        inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
        if inside.any():
            quiet = min(quiet, (float(db[inside].min()), float(f[inside][np.argmin(db[inside])])))
        loud = max(loud, (float(-db.min()), float(f[np.argmin(db)])))
        print(f"# {unit}, {share:.0%}, {band}: peak {-db.min():.2f} dB at {f[np.argmin(db)]:g} Hz, {open_:.1%} open")
    name = f"{unit}, {share:.0%} of the first clip"
    yield f"{name}: worst direction, at {quiet[1]:g} Hz", f"{quiet[0]:.2f} dB", f"{asked[0]:g} dB", quiet[0] >= asked[0]
    yield f"{name}: peak, at {loud[1]:g} Hz", f"{loud[0]:.2f} dB", f"{asked[1]:g} dB", loud[0] <= asked[1]
