"""Weights for loop shaping, built from corner frequencies, in continuous or discrete time.

All are of minimum phase and invertible: each gain is prescribed as a ratio of Butterworth magnitudes and the stable
factor of it is taken, so that no phase of a sum can carve a notch into the weight.
"""

import numpy as np

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import realize
from ultraquiet.linalg.discretize import tustin
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.interconnect import append, series
from ultraquiet.values.state_space import StateSpace


def band_pass(
    band_hz: tuple[float, float],
    height: float,
    floor: float,
    order: int = 4,
    rate_hz: float | None = None,
    channels: int = 1,
) -> StateSpace:
    """Return a weight of gain `height` inside a band and `floor` far outside it, on each of several channels.

    |W|^2 = floor^2 (x^2h + (height / floor)^2) / (x^2h + 1), x = (f^2 - f0^2) / (f (high - low)), h = order / 2.

    Args:
        band_hz: lower and upper corner, Hz; f0 is their geometric mean.
        height: gain at f0.
        floor: gain at 0 Hz and far above the band.
        order: states per channel, even; each edge falls with half of it times 20 dB per decade.
        rate_hz: None for continuous time; a rate gives Tustin's rule, exact at f0.
        channels: copies on the diagonal.

    Raises:
        InputError: an empty band, a corner beyond Nyquist, an odd order.

    >>> W = band_pass((10.0, 100.0), height=10.0, floor=0.5)
    >>> [round(float(abs(W.frequency_response([f])[0, 0, 0])), 2) for f in (0.0, 1000**0.5, 1e5)]
    [0.5, 10.0, 0.5]
    """
    who = "band_pass"
    if np.shape(band_hz) != (2,):
        raise InputError(f"{who}: 'band_hz' must be two frequencies in Hz, got {band_hz!r}.")
    low, high = (positive(who, "band_hz", f, "Hz") for f in band_hz)
    if not low < high or (rate_hz is not None and high >= rate_hz / 2):
        below = "" if rate_hz is None else f" and end below Nyquist, {rate_hz / 2:g} Hz"
        raise InputError(f"{who}: 'band_hz' must rise{below}, got {low:g} to {high:g} Hz.")
    half = whole(who, "order", order, 2) // 2
    if order != 2 * half:
        raise InputError(f"{who}: 'order' must be even, got {order}.")
    ratio = positive(who, "height", height) / positive(who, "floor", floor)
    centre, width = np.sqrt(low * high), (high - low) / np.sqrt(low * high)
    poles = _to_band(_butterworth(half), width)
    zeros = _to_band(_butterworth(half) * ratio ** (1 / half), width)
    return realised(zeros, poles, floor, centre, rate_hz, channels)


def low_pass(
    corner_hz: float, height: float, floor: float, order: int = 2, rate_hz: float | None = None, channels: int = 1
) -> StateSpace:
    """Return a weight of gain `height` from rest to a corner and `floor` far above it, on each of several channels.

    |W|^2 = floor^2 (x^2n + (height / floor)^2) / (x^2n + 1), x = f / corner: a `band_pass` without its lower edge.

    Args:
        corner_hz: where the gain has fallen by 3 dB, Hz.
        height: gain at 0 Hz.
        floor: gain far above the corner.
        order: states per channel; the edge falls with 20 dB per decade for each.
        rate_hz: None for continuous time; a rate gives Tustin's rule, exact at the corner.
        channels: copies on the diagonal.

    >>> W = low_pass(10.0, height=10.0, floor=0.5)
    >>> [round(float(abs(W.frequency_response([f])[0, 0, 0])), 2) for f in (0.0, 10.0, 1e5)]
    [10.0, 7.08, 0.5]
    """
    who = "low_pass"
    ratio = positive(who, "height", height) / positive(who, "floor", floor)
    _refuse_beyond_nyquist(who, "corner_hz", corner_hz, rate_hz)
    poles = _butterworth(whole(who, "order", order, 1))
    zeros = poles * ratio ** (1 / order)
    return realised(zeros, poles, floor, corner_hz, rate_hz, channels)


def high_pass(
    corner_hz: float, low: float, high: float, order: int = 1, rate_hz: float | None = None, channels: int = 1
) -> StateSpace:
    """Return a weight of gain `low` that rises from `corner_hz` on, with `order` times 20 dB per decade, to `high`.

    |W|^2 = high^2 (x^2n + 1) / (x^2n + (high / low)^2), x = f / corner; falling when `high` is below `low`.

    Args:
        corner_hz: where the gain leaves `low`, Hz.
        low: gain at 0 Hz.
        high: gain at infinite frequency (at Nyquist when discrete).
        order: states per channel.
        rate_hz: None for continuous time; a rate gives Tustin's rule, exact at the corner.
        channels: copies on the diagonal.

    >>> W = high_pass(400.0, low=1e-3, high=1e-1)
    >>> round(float(abs(W.frequency_response([0.0])[0, 0, 0])), 6)
    0.001
    """
    who = "high_pass"
    ratio = positive(who, "high", high) / positive(who, "low", low)
    _refuse_beyond_nyquist(who, "corner_hz", corner_hz, rate_hz)
    zeros = _butterworth(whole(who, "order", order, 1))
    poles = zeros * ratio ** (1 / order)
    return realised(zeros, poles, high, corner_hz, rate_hz, channels)


def peak(
    tone_hz: float, height: float, zeta: float = 0.01, rate_hz: float | None = None, channels: int = 1
) -> StateSpace:
    """Return a weight of one everywhere but near a tone, where it reaches `height`.

    W = (s^2 + 2 zeta height w s + w^2) / (s^2 + 2 zeta w s + w^2).

    Args:
        tone_hz: where the peak stands, Hz.
        height: gain there.
        zeta: half the relative width of the peak.
        rate_hz: None for continuous time; a rate gives Tustin's rule, exact at the tone.
        channels: copies on the diagonal.

    >>> W = peak(25.0, height=100.0, rate_hz=3500.0)
    >>> round(float(abs(W.frequency_response([25.0])[0, 0, 0])), 3)
    100.0
    """
    who = "peak"
    positive(who, "height", height)
    positive(who, "zeta", zeta)
    _refuse_beyond_nyquist(who, "tone_hz", tone_hz, rate_hz)
    zeros = np.roots([1.0, 2 * zeta * height, 1.0]).astype(np.complex128)
    poles = np.roots([1.0, 2 * zeta, 1.0]).astype(np.complex128)
    return realised(zeros, poles, 1.0, tone_hz, rate_hz, channels)


def rational(
    gain: float,
    zeros_rad_s: tuple[complex, ...],
    poles_rad_s: tuple[complex, ...],
    rate_hz: float | None,
    channels: int,
) -> StateSpace:
    """Return gain prod(s - zero) / prod(s - pole) on each channel, sampled by Tustin's rule when a rate is given.

    Raises:
        InputError: more zeros than poles: a weight must be proper.
    """
    if len(zeros_rad_s) > len(poles_rad_s):
        raise InputError(
            f"rational: a weight must be proper, got {len(zeros_rad_s)} zeros and {len(poles_rad_s)} poles; add a pole "
            "beyond the band."
        )
    num: Array = gain * np.atleast_1d(np.poly(np.array(zeros_rad_s))).real
    den: Array = np.atleast_1d(np.poly(np.array(poles_rad_s))).real
    M = realize.sections(np.concatenate([np.zeros(len(den) - len(num)), num]), den)
    return _copies(M, rate_hz, None, channels)


def reciprocal(weight: StateSpace) -> StateSpace:
    """Return 1 / W of one channel: stable, for W is of minimum phase, and with a feedthrough.

    >>> W = low_pass(10.0, height=10.0, floor=0.5)
    >>> round(float(abs(reciprocal(W).frequency_response([0.0])[0, 0, 0])), 6)
    0.1
    """
    D = 1.0 / weight.D
    B, C = weight.B @ D, -D @ weight.C
    return StateSpace(weight.A + weight.B @ C, B, C, D, weight.rate_hz)


def with_tones(
    weight: StateSpace, tones_hz: tuple[float, ...], height: float = 100.0, zeta: float = 0.002
) -> StateSpace:
    """Return a weight with a peak at each of several tones on every output.

    Args:
        weight: any, at its own rate.
        tones_hz: where the peaks stand, Hz.
        height: gain of the peaks.
        zeta: half the relative width of the peaks.

    >>> W = with_tones(peak(25.0, height=3.0, rate_hz=3500.0), (100.0,), height=50.0)
    >>> round(float(abs(W.frequency_response([100.0])[0, 0, 0])))
    50
    """
    for tone_hz in tones_hz:
        weight = series(weight, peak(tone_hz, height, zeta, weight.rate_hz, weight.D.shape[0]))
    return weight


def _refuse_beyond_nyquist(who: str, name: str, f_hz: float, rate_hz: float | None) -> None:
    positive(who, name, f_hz, "Hz")
    if rate_hz is not None and f_hz >= rate_hz / 2:
        raise InputError(f"{who}: {name!r} must be below Nyquist, {rate_hz / 2:g} Hz, got {f_hz:g} Hz.")


def _butterworth(n: int) -> Array:
    """Return the poles of a Butterworth filter, real ones exactly real."""
    k = np.arange(n)
    p: Array = np.exp(1j * np.pi * (2 * k + n + 1) / (2 * n))
    return _exact(p)


def _to_band(p: Array, width: float) -> Array:
    """Return the roots s of (s^2 + 1) / (width s) = p."""
    half = p * width / 2
    root = np.sqrt(half**2 - 1 + 0j)
    return _exact(np.concatenate([half + root, half - root]))


def _exact(roots: Array) -> Array:
    """Return roots with imaginary parts of round-off set to zero."""
    return np.where(np.abs(roots.imag) < 1e-12 * np.abs(roots), roots.real, roots)


def realised(
    zeros: Array, poles: Array, gain: float, unit_hz: float, rate_hz: float | None, channels: int
) -> StateSpace:
    """Return gain prod(s - zeros) / prod(s - poles) on each channel, s in `unit_hz`, exact there when sampled."""
    num, den = np.real(np.poly(zeros)), np.real(np.poly(poles))
    A, B, C, D = realize.sections(
        np.asarray(np.atleast_1d(gain * num), dtype=np.float64), np.asarray(np.atleast_1d(den), dtype=np.float64)
    )
    w = 2 * np.pi * unit_hz
    return _copies((A * w, B * np.sqrt(w), C * np.sqrt(w), D), rate_hz, unit_hz, channels)


def _copies(M: realize.Matrices, rate_hz: float | None, exact_hz: float | None, channels: int) -> StateSpace:
    one = StateSpace(*(M if rate_hz is None else tustin(*M, rate_hz, exact_hz)), rate_hz=rate_hz)
    return append(*[one] * channels)
