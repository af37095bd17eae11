"""Fractional octave bands: exact centre frequencies, levels from a spectrum or by filters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, between, frozen, positive, signal_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet.spectra.averaging import Averaging
from ultraquiet.spectra.psd import PowerSpectrum
from ultraquiet.values import Channel, Record
from ultraquiet.values.handed_over.kinds import of_kind

# IEC 61260-1:2014, 5.2: the octave ratio, base ten, and the reference frequency.
OCTAVE = 10.0**0.3
REFERENCE_HZ = 1000.0
# Nominal mid-band frequencies of one-third octaves in a decade (IEC 61260-1:2014, annex E).
NOMINAL = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)
# A band narrower than the window's resolution holds its neighbours' power as well.
RESOLVED = 1.0
FINEST = 24  # bands per octave that anybody uses
FILTER_ORDER = 3
# Noise passed by a Butterworth filter over that between its half-power edges: (pi / 2n) / sin(pi / 2n).
NOISE_WIDTH = np.pi / (2 * FILTER_ORDER) / np.sin(np.pi / (2 * FILTER_ORDER))
# Filters ring for about this many of their inverse bandwidths; that much is left out before the level is taken.
SETTLING = 3.0


@dataclass(frozen=True)
class Bands:
    """Fractional octave bands: exact centres and edges in Hz, `(band,)`.

    >>> thirds = octave_bands(1.0, 80.0)
    >>> len(thirds.centre_hz), thirds.nominal_hz[:4].tolist(), float(thirds.low_hz[0].round(4))
    (20, [1.0, 1.25, 1.6, 2.0], 0.8913)
    """

    fraction: int
    centre_hz: FloatArray

    @property
    def low_hz(self) -> FloatArray:
        """Lower edges f_m G^(-1/2b)."""
        return self.centre_hz * OCTAVE ** (-0.5 / self.fraction)

    @property
    def high_hz(self) -> FloatArray:
        """Upper edges f_m G^(+1/2b)."""
        return self.centre_hz * OCTAVE ** (0.5 / self.fraction)

    @property
    def nominal_hz(self) -> FloatArray:
        """The names people use: rounded centres for one-third octaves and octaves, three digits otherwise."""
        if self.fraction not in (1, 3):
            return np.array([float(f"{f:.3g}") for f in self.centre_hz])
        steps = np.round(10.0 * np.log10(self.centre_hz)).astype(int)
        return np.array([NOMINAL[k % 10] * 10.0 ** (k // 10) for k in steps])


@dataclass(frozen=True, eq=False)
class BandLevels:
    """Root mean square in each band, `(channel, band)`, in the channels' units.

    `error` `(band,)` is the relative standard error of a level from the finite time of averaging.
    """

    bands: Bands
    rms: FloatArray
    error: FloatArray
    channels: tuple[Channel, ...]
    estimator: str


def octave_bands(start_hz: float, stop_hz: float, fraction: int = 3) -> Bands:
    """Return the bands whose centres lie between two frequencies, nominal names counting as their centres.

    f_m = 1000 G^(x/b) for odd b, 1000 G^((2x+1)/(2b)) for even b, with G = 10^0.3.

    Args:
        start_hz: lowest centre.
        stop_hz: highest centre.
        fraction: bands per octave, b; 3 for one-third octaves.

    Raises:
        InputError: an empty range.

    Reference: IEC 61260-1:2014, 5.2 to 5.5.
    """
    b = whole("octave_bands", "fraction", fraction, 1, FINEST)
    low = positive("octave_bands", "start_hz", start_hz, "Hz")
    high = positive("octave_bands", "stop_hz", stop_hz, "Hz")
    shift = 0.0 if b % 2 else 0.5
    # A nominal name lies up to 1 % from its exact centre: it must not lose its band.
    reach = 0.01 * b / np.log(OCTAVE)
    first = np.ceil(b * np.log(low / REFERENCE_HZ) / np.log(OCTAVE) - shift - reach)
    last = np.floor(b * np.log(high / REFERENCE_HZ) / np.log(OCTAVE) - shift + reach)
    if last < first:
        raise InputError(f"octave_bands: there is no centre of a 1/{b} octave between {low:g} and {high:g} Hz.")
    return Bands(b, frozen(REFERENCE_HZ * OCTAVE ** ((np.arange(first, last + 1) + shift) / b)))


def band_levels(
    spectrum: PowerSpectrum, fraction: int = 3, start_hz: float | None = None, stop_hz: float | None = None
) -> BandLevels:
    """Return the levels of fractional octaves by integrating a power spectral density between the exact edges.

    rms^2 = integral of S from f_m G^(-1/2b) to f_m G^(1/2b), S constant over the width of each line

    Args:
        spectrum: power spectral densities.
        fraction: bands per octave.
        start_hz: lowest centre; by default the lowest band that the spectrum's window resolves.
        stop_hz: highest centre; by default the highest band that ends below half the rate.

    Raises:
        InputError: a band narrower than the resolution or beyond half the rate.

    >>> from ultraquiet.spectra import psd
    >>> noise = psd(np.random.default_rng(0).standard_normal(2**16), rate_hz=1000.0)
    >>> result = band_levels(noise, start_hz=100.0, stop_hz=100.0)
    >>> bool(abs(result.rms[0, 0] / np.sqrt(2e-3 * 23.08) - 1.0) < 0.1)
    True

    Reference: IEC 61260-1:2014; statistics Bendat and Piersol 2010, section 8.5, doi:10.1002/9781118032428.
    """
    plan = of_kind("band_levels", "spectrum", spectrum, PowerSpectrum).averaging
    fraction = whole("band_levels", "fraction", fraction, 1, FINEST)
    width = OCTAVE ** (0.5 / fraction) - OCTAVE ** (-0.5 / fraction)
    least, most = RESOLVED * plan.enbw_hz / width, plan.rate_hz / 2 / OCTAVE ** (0.5 / fraction)
    bands = octave_bands(
        least * OCTAVE ** (0.5 / fraction) if start_hz is None else start_hz,
        most * 0.99 if stop_hz is None else stop_hz,
        fraction,
    )
    _refuse_unresolved(bands, plan, least)
    power = _integral(spectrum, bands.high_hz) - _integral(spectrum, bands.low_hz)
    degrees = 2.0 * plan.independent * np.maximum(1.0, (bands.high_hz - bands.low_hz) / plan.statistical_hz)
    # A mean square scatters by sqrt(2 / degrees), its root by half of that.
    error = 0.5 * np.sqrt(2.0 / degrees)
    text = f"1/{fraction} octaves from the spectrum, {spectrum.estimator}"
    return BandLevels(bands, frozen(np.sqrt(np.maximum(power, 0.0))), frozen(error), spectrum.channels, text)


def filtered_levels(
    signals: Record | ArrayLike,
    rate_hz: float | None = None,
    fraction: int = 3,
    start_hz: float = 1.0,
    stop_hz: float = 80.0,
) -> BandLevels:
    """Return the levels of fractional octaves by band filters in time, as a sound level meter does it.

    Butterworth band passes of sixth order about the exact centres, as wide for noise as the band is (and 5 % narrower
    at half power); the settling of each filter is left out, and the mean of each channel, which no band holds but each
    filter would have to settle from.

    Args:
        signals: a record, whose outputs are taken, or an array together with `rate_hz`.
        rate_hz: samples per second; taken from a record.
        fraction: bands per octave.
        start_hz: lowest centre.
        stop_hz: highest centre.

    Raises:
        InputError: a record shorter than twice the settling of its narrowest filter, a band beyond half the rate.

    >>> t = np.arange(20000) / 1000.0
    >>> tone = np.sqrt(2) * np.sin(2 * np.pi * 50.0 * t)
    >>> result = filtered_levels(tone, rate_hz=1000.0, start_hz=40.0, stop_hz=63.0)
    >>> result.bands.nominal_hz.tolist(), result.rms.round(2).tolist()[0][1]
    ([40.0, 50.0, 63.0], 1.0)

    Reference: IEC 61260-1:2014.
    """
    from scipy.signal import butter, sosfilt

    if isinstance(signals, Record):
        x, rate, names = signals.outputs, signals.rate_hz, signals.sensors
    else:
        rate = between("filtered_levels", "rate_hz", np.nan if rate_hz is None else rate_hz, 1e-9, 1e12, "Hz")
        x = signal_array("filtered_levels", "signals", signals)
        names = tuple(Channel(f"channel {k + 1}", "unit") for k in range(len(x)))
    bands = octave_bands(start_hz, stop_hz, fraction)
    if bands.high_hz[-1] >= rate / 2:
        raise InputError(
            f"filtered_levels: the band at {bands.nominal_hz[-1]:g} Hz reaches half the rate, {rate / 2:g} Hz."
        )
    settling = np.ceil(SETTLING * rate / (bands.high_hz - bands.low_hz)).astype(int)
    if x.shape[1] < 2 * settling[0]:
        raise InputError(
            f"filtered_levels: {x.shape[1]} samples are too few for the band at {bands.nominal_hz[0]:g} Hz, "
            f"which needs {2 * settling[0]}."
        )
    x = x - x.mean(axis=1, keepdims=True)
    rms = np.empty((len(x), len(bands.centre_hz)))
    half = (bands.high_hz - bands.low_hz) / NOISE_WIDTH / 2.0
    middle = np.sqrt(bands.centre_hz**2 + half**2)
    for k, edges in enumerate(zip(middle - half, middle + half, strict=True)):
        sos = butter(FILTER_ORDER, edges, "bandpass", fs=rate, output="sos")
        passed = np.asarray(sosfilt(sos, x, axis=1))[:, settling[k] :]
        rms[:, k] = np.sqrt(np.mean(passed**2, axis=1))
    seconds = (x.shape[1] - settling) / rate
    error = 0.5 / np.sqrt(seconds * (bands.high_hz - bands.low_hz))
    text = f"1/{fraction} octaves by Butterworth band passes of order {2 * FILTER_ORDER}, {seconds[0]:.3g} s averaged"
    return BandLevels(bands, frozen(rms), frozen(error), names, text)


def _integral(spectrum: PowerSpectrum, edges_hz: FloatArray) -> FloatArray:
    """Return the power below each edge, `(channel, edge)`; a line spans half its distance to either side."""
    step = spectrum.averaging.line_hz
    ends = np.append(spectrum.f_hz[0], spectrum.f_hz + step / 2)
    ends[0] = max(spectrum.f_hz[0] - step / 2, 0.0)
    below = np.cumsum(spectrum.values * np.diff(ends), axis=1)
    below = np.concatenate([np.zeros((len(below), 1)), below], axis=1)
    return np.array([np.interp(edges_hz, ends, row) for row in below])


def _refuse_unresolved(bands: Bands, plan: Averaging, least_hz: float) -> None:
    first, width = bands.nominal_hz[0], float(bands.high_hz[0] - bands.low_hz[0])
    if bands.centre_hz[0] < least_hz:
        needed = int(np.ceil(plan.segment_samples * RESOLVED * plan.enbw_hz / width))
        raise InputError(
            f"band_levels: the band at {first:g} Hz is {width:.3g} Hz wide, less than the resolution of "
            f"{plan.enbw_hz:.3g} Hz; take segments of {needed} samples, or start above {least_hz:.3g} Hz."
        )
    if bands.high_hz[-1] > plan.rate_hz / 2:
        raise InputError(
            f"band_levels: the band at {bands.nominal_hz[-1]:g} Hz ends at {bands.high_hz[-1]:.4g} Hz, beyond half the "
            f"rate of {plan.rate_hz:g} Hz."
        )
