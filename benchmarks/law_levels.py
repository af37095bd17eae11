"""The packaged study's quiet law as its compiled code, driven louder and softer, on both units with hysteresis on.

In passes of 3-10, 10-20, 20-50, 50-130 and 130-1700 Hz all actuators are disturbed at once by a multisine, in as many
runs as there are actuators, turned against one another by the columns of the Fourier matrix F; in open loop and in
closed, at shares of the level at which that pass first meets a limit. The loop is not linear: what one draw of the
phases leaves at a line, another does not, so several draws are listened to, and what counts is their mean (robust
method, Pintelon and Schoukens 2012, doi:10.1002/9781118287422, section 4.3). With a draw d of the multisine's spectrum

    R = Y (d F)^-1, mean and variance over the draws, open and closed;   S = R_closed R_open^-1.

Its largest singular value s = u* S v is counted with two deviations of what noise and the loop's curves leave, on top:

    var s = sum_ik (|u_i|^2 var Rc_ik + s^2 |v_i|^2 var Ro_ik) |w_k|^2,   w = R_open^-1 v.

Each line is heard with its neighbours as far as noise alone tells them apart, as `measure_sensitivity` does.
Lines that the plant answers faintly are driven harder. ULTRAQUIET_DEMO names the folder of a study walked before.
"""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

import ultraquiet as uq
from benchmarks.quiet_law import BAND_HZ, FOLDER, LAW, UNITS, plants
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate.sensitivity.neighbours import LinesOfS

PASSES_HZ = ((3.0, 10.0), (10.0, 20.0), (20.0, 50.0), (50.0, 130.0), (130.0, 1700.0))
ASKED = {0.1: (19.0, 6.5), 0.4: (20.0, 6.0), 0.8: (19.0, 6.5)}
PERIOD_S, DRAWS, PERIODS, DEVIATIONS = 4.0, 5, 3, 2.0  # 60 s are listened to in each run of a pass
POWER, HARDEST = 0.75, 10.0  # of how faint a line is, by which it is driven harder, and how much at most
LEVELLINGS = 3
BESIDE = 5  # lines over which a variance is smoothed: that of five draws alone is known to a factor of two

Row = tuple[str, str, str, bool]


@dataclass(frozen=True, eq=False)
class Responses:
    """Mean over the draws, `(lines, ny, nu)`, the variance of that mean, and the largest share of a limit used."""

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


def listened(bench, controller, sizes: np.ndarray, lines: np.ndarray, seeds: list[int], periods: int) -> Responses:
    """Disturb all actuators by lines of the given sizes, drawn phases for each seed; the first period settles."""
    n, nu = round(PERIOD_S * bench.rate_hz), len(bench.actuators)
    F = np.exp(2j * np.pi * np.outer(np.arange(nu), np.arange(nu)) / nu)
    found, used = [], 0.0
    for seed in seeds:
        drawn = sizes * np.exp(2j * np.pi * np.random.default_rng(seed).random(lines.size))
        Y = np.zeros((lines.size, len(bench.sensors), nu), dtype=complex)
        for k in range(nu):
            spectrum = np.zeros((nu, n // 2 + 1), dtype=complex)
            spectrum[:, lines] = F[:, k : k + 1] * drawn * n / 2
            d = np.tile(np.fft.irfft(spectrum, n), 1 + periods)
            record = bench.run(np.zeros_like(d), disturbance=d, controller=controller)
            mean = record.outputs[:, n:].reshape(len(bench.sensors), periods, n).mean(axis=1)
            Y[:, :, k] = np.fft.rfft(mean)[:, lines].T * 2 / n
            used = max(used, *(np.abs(x).max() / c.high for x, c in _channels(record)))
            used = max(used, *(np.abs(x).max() / c.high for x, c in zip(d, bench.actuators, strict=True)))
        found.append(Y @ F.conj().T / nu / drawn[:, None, None])
    variance = np.var(found, axis=0, ddof=1) / len(seeds) if len(seeds) > 1 else np.zeros_like(found[0], dtype=float)
    return Responses(np.mean(found, axis=0), uniform_filter1d(variance, BESIDE, axis=0, mode="nearest"), used)


def _channels(record: uq.Record) -> Iterator[tuple[np.ndarray, uq.Channel]]:
    yield from zip(record.outputs, record.sensors, strict=True)
    yield from zip(record.inputs, record.actuators, strict=True)


def shape(bench, code, lines: np.ndarray, seed: int) -> np.ndarray:
    """Return sizes of lines, of RMS one together: between even ones and those at which all are heard alike.

    How faint a line is is listened to half as loud as even ones may be: softer, noise is heard in its place.
    """
    even = np.full(lines.size, np.sqrt(2 / lines.size))
    loud = first_clip(bench, code, even, lines, seed) / 2
    heard = listened(bench, None, loud * even, lines, [seed], 1).mean
    faint = np.linalg.svd(heard, compute_uv=False)[:, -1]
    sizes = np.minimum((faint.mean() / np.maximum(faint, 1e-300)) ** POWER, HARDEST)
    return sizes * np.sqrt(2) / np.linalg.norm(sizes)


def first_clip(bench, code, sizes: np.ndarray, lines: np.ndarray, seed: int) -> float:
    """Return by what the lines may grow until a command, a reading or the disturbance meets its limit."""
    level = 1.0
    for _ in range(LEVELLINGS):  # hysteresis: what is used does not rise in proportion
        level /= max(listened(bench, each, level * sizes, lines, [seed], 1).used for each in (None, code))
    return level


def sizes(bench, code, band_hz: tuple[float, float], share: float, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the lines of a pass in Hz, the largest singular value of S as it is counted, and the worst deviation."""
    f = np.fft.rfftfreq(round(PERIOD_S * bench.rate_hz), 1 / bench.rate_hz)
    lines = np.flatnonzero((f >= band_hz[0]) & (f <= band_hz[1]))
    shaped = shape(bench, code, lines, seed)
    level = share * first_clip(bench, code, shaped, lines, seed)
    seeds = [DRAWS * seed + k for k in range(DRAWS)]
    opened, closed = (listened(bench, each, level * shaped, lines, seeds, PERIODS) for each in (None, code))
    s, deviation = counted(opened, closed)
    return f[lines], s + DEVIATIONS * deviation, float((deviation / s).max())


def counted(opened: Responses, closed: Responses) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest singular value of S at each line and its deviation, both `(lines,)`."""
    inverse = np.linalg.inv(opened.mean)
    read = (closed.mean @ inverse).astype(np.complex128)
    weakest, size = (np.linalg.norm(x, 2, axis=(1, 2)) for x in (inverse, read))
    closed_rows, opened_rows = (np.sqrt(each.variance.mean(axis=2)).T for each in (closed, opened))
    rows = np.hypot(closed_rows, np.sqrt(np.einsum("lij,jl->il", np.abs(read) ** 2, opened_rows**2)))
    noise = [weakest * np.linalg.norm(closed_rows, axis=0), weakest * size * np.linalg.norm(opened_rows, axis=0)]
    alone = np.hypot(*noise)
    lines = LinesOfS(np.moveaxis(read, 0, 2), np.array(noise), np.zeros(len(read)), rows, opened.mean, stride=1)
    S, left, _ = lines.with_neighbours(np.arange(len(read)))
    s, deviation = _largest(np.moveaxis(S, 2, 0), inverse, opened, closed)
    return s, deviation * np.hypot(*left) / alone


def _largest(S, inverse, opened: Responses, closed: Responses) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest singular value of S and what is left open of it by a line alone, both `(lines,)`."""
    u, s, vh = np.linalg.svd(S)
    left, right = np.abs(u[:, :, 0]) ** 2, np.abs(vh[:, 0]) ** 2
    w = np.abs(inverse @ np.conj(vh[:, 0])[:, :, None])[:, :, 0] ** 2
    variance = np.einsum("li,lik,lk->l", left, closed.variance, w)
    variance += s[:, 0] ** 2 * np.einsum("li,lik,lk->l", right, opened.variance, w)
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
