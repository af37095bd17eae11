"""What a loop makes of broadband disturbances, measured on the bench by its sensors."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, rising_band, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.loop import disturb, samples_of
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.controller import Controller

WHO = "noise_reduction"
MEASURED_SHARE = 0.5  # of a run; before it the loop settles
LEAST = 3  # samples of a run: fewer hold no line between rest and Nyquist


@dataclass(frozen=True, eq=False)
class NoiseReduction:
    """RMS of every sensor `(ny,)` in its own unit, loop open and closed, under the same noise at the plant's input.

    `reduction_db` = -20 log10(closed / open); positive is quieter. `band_hz` is where the noise has its power; the RMS
    counts all frequencies, what the loop amplifies beside the band too.
    """

    band_hz: tuple[float, float]
    open_rms: FloatArray
    closed_rms: FloatArray
    reduction_db: FloatArray


def noise_reduction(
    bench: Bench,
    controller: StateSpace | Controller,
    band_hz: tuple[float, float],
    amplitude: float = 1.0,
    duration_s: float = 4.0,
    seed: int = 0,
) -> NoiseReduction:
    """Disturb all actuators with independent noise of one band, open and closed loop, and compare the sensors.

    Args:
        bench: any bench; nothing of it is used but its `run`.
        controller: acts as u = K y.
        band_hz: (low, high) in Hz, where the disturbances have their power, evenly.
        amplitude: RMS of the disturbance at each actuator, in its unit.
        duration_s: length of each run in seconds; the second half is measured.
        seed: of the noise.

    Returns:
        `NoiseReduction`.

    Raises:
        InputError: a band beyond the Nyquist frequency, a run so short or a band so narrow that it holds no line.
    """
    rate = bench.rate_hz
    low, high = rising_band(WHO, band_hz, rate)
    n = samples_of(WHO, duration_s, rate, LEAST)
    d = positive(WHO, "amplitude", amplitude) * band_noise(WHO, len(bench.actuators), n, rate, (low, high), seed)
    with task("noise", 2) as progress:
        opened = _rms(disturb(bench, d))
        progress.advance(note="open")
        closed = _rms(disturb(bench, d, controller))
        progress.advance(note="closed")
    tiny = np.finfo(float).tiny
    reduction = 20 * np.log10(np.maximum(opened, tiny) / np.maximum(closed, tiny))
    return NoiseReduction((low, high), opened, closed, reduction)


def band_noise(
    who: str, channels: int, n: int, rate_hz: float, band_hz: tuple[float, float], seed: int, even: bool = False
) -> FloatArray:
    """Return Gaussian noise `(channels, n)` of RMS one, of period `n`, whose spectrum is zero outside the band.

    `even` lines are all of one size and their phases alone are drawn: its samples are as good as Gaussian, and what
    resonances make of a few lines does not hang on the draw.
    """
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    inside = (f >= band_hz[0]) & (f <= band_hz[1])
    if not inside.any():
        raise InputError(
            f"{who}: a run of {n / rate_hz:g} s holds no line between {band_hz[0]:g} and {band_hz[1]:g} Hz; make "
            "it longer or the band wider."
        )
    draw = np.random.default_rng(whole(who, "seed", seed, 0)).standard_normal((2, channels, f.size))
    spectrum = draw[0] + 1j * draw[1]
    noise = np.fft.irfft(np.where(inside, spectrum / np.abs(spectrum) if even else spectrum, 0.0), n, axis=1)
    return noise / np.sqrt(np.mean(noise**2, axis=1, keepdims=True))


def _rms(record: Record) -> FloatArray:
    y = record.outputs[:, int(record.samples * (1 - MEASURED_SHARE)) :]
    return np.asarray(y.std(axis=1), dtype=np.float64)
