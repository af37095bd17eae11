"""Checks of arguments that produce the same sentences everywhere."""

import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.errors import InputError, RateError

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Shape = float | tuple[tuple[float, ...], tuple[float, ...]]  # a number, or (frequencies in Hz, values)
OfFrequency = Callable[[FloatArray], FloatArray]


def real_array(who: str, name: str, value: ArrayLike, ndim: int) -> FloatArray:
    """Return `value` as a fresh finite float64 array of `ndim` dimensions, or say what is wrong with it."""
    try:
        candidate = np.array(value)
        if np.iscomplexobj(candidate):
            raise TypeError("complex values")
        array = candidate.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{who}: '{name}' must be a real array, got {type(value).__name__} ({error}).") from None
    if array.ndim != ndim:
        raise InputError(f"{who}: '{name}' must have {ndim} dimensions, got shape {array.shape}.")
    bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if bad:
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{who}: '{name}' has {bad} NaN or infinite values, the first at index {first}; remove them.")
    return array


def numbers(who: str, name: str, value: ArrayLike | None) -> FloatArray:
    """Return one real number or several, finite, as a one-dimensional array."""
    try:
        array = np.atleast_1d(np.asarray(value))
        if array.dtype.kind not in "biuf":  # text, None, complex numbers
            raise ValueError
    except ValueError:
        raise InputError(f"{who}: '{name}' must be one number or several, got {value!r}.") from None
    return real_array(who, name, array, 1)


def signal_array(who: str, name: str, value: ArrayLike) -> FloatArray:
    """Return signals as `(channel, sample)`; one dimension is one channel."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{who}: '{name}' must be signals of one length ({error}).") from None
    return real_array(who, name, array[np.newaxis, :] if array.ndim == 1 else array, 2)


def frequency_array(who: str, f_hz: ArrayLike) -> FloatArray:
    """Return non-negative frequencies in Hz as a one-dimensional array."""
    array = real_array(who, "f_hz", np.atleast_1d(np.asarray(f_hz)), 1)
    if array.size and array.min() < 0:
        raise InputError(f"{who}: 'f_hz' must not be negative, got {array.min():g} Hz.")
    return array


def some_lines(who: str, f_hz: ArrayLike) -> FloatArray:
    """Return frequencies as `frequency_array` does, at least one."""
    array = frequency_array(who, f_hz)
    if not array.size:
        raise InputError(f"{who}: 'f_hz' holds no frequencies; give at least one in Hz.")
    return array


def rising_band(who: str, band_hz: ArrayLike, rate_hz: float | None = None) -> tuple[float, float]:
    """Return two rising frequencies in Hz above zero, below Nyquist where a rate is given."""
    band = real_array(who, "band_hz", band_hz, 1)
    if band.size != 2 or not 0 < band[0] < band[1]:
        raise InputError(f"{who}: 'band_hz' must be two rising frequencies above zero, got {tuple(band.tolist())}.")
    if rate_hz is not None and band[1] >= rate_hz / 2:
        raise InputError(
            f"{who}: 'band_hz' ends at {band[1]:g} Hz, not below Nyquist's {rate_hz / 2:g} Hz; end it lower."
        )
    return float(band[0]), float(band[1])


def positive(who: str, name: str, value: float, unit: str = "") -> float:
    """Return a finite number above zero."""
    number = _number(who, name, value)
    if not number > 0:
        raise InputError(f"{who}: '{name}' must be above zero{_in(unit)}, got {number:g}.")
    return number


def between(who: str, name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """Return a number inside the closed interval [low, high]."""
    number = _number(who, name, value)
    if not low <= number <= high:
        raise InputError(f"{who}: '{name}' must lie between {low:g} and {high:g}{_in(unit)}, got {number:g}.")
    return number


def tone_below_nyquist(who: str, name: str, f_hz: float, rate_hz: float) -> float:
    """Return a frequency in Hz above zero and below half the rate, where a sampled sine is none any more."""
    number = positive(who, name, f_hz, "Hz")
    if number >= rate_hz / 2:
        raise InputError(f"{who}: '{name}' must lie below Nyquist's {rate_hz / 2:g} Hz, got {number:g} Hz.")
    return number


def whole(who: str, name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return a whole number not below `low` (and not above `high`)."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(f"{who}: '{name}' must be a whole number, got {value!r}.")
    number = int(cast("int | np.integer[Any]", value))
    if number < low or (high is not None and number > high):
        span = f"at least {low}" if high is None else f"between {low} and {high}"
        raise InputError(f"{who}: '{name}' must be {span}, got {number}.")
    return number


def yes_or_no(who: str, name: str, value: Any) -> None:
    """Refuse a switch that is neither True nor False, though it may count as one of them."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{who}: '{name}' must be True or False, got {value!r}.")


def one_of(who: str, name: str, value: str, choices: Sequence[str]) -> str:
    """Return `value` when it is among the choices."""
    # whether an array is among them has no one answer
    if isinstance(value, np.ndarray) or value not in choices:
        got = "an array" if isinstance(value, np.ndarray) else repr(value)
        raise InputError(f"{who}: '{name}' must be one of {', '.join(map(repr, choices))}, got {got}.")
    return value


def rate(who: str, rate_hz: float | None) -> float | None:
    """Return a sampling rate in Hz; None stands for continuous time."""
    return None if rate_hz is None else positive(who, "rate_hz", rate_hz, "Hz")


def same_rate(who: str, first: str, first_hz: float | None, second: str, second_hz: float | None) -> None:
    """Refuse to mix continuous with discrete time or two sampling rates."""
    same = first_hz == second_hz if None in (first_hz, second_hz) else _close(first_hz, second_hz)
    if not same:
        raise RateError(
            f"{who}: {first} is {_time(first_hz)} but {second} is {_time(second_hz)}; convert one of them first."
        )


def _close(first_hz: float | None, second_hz: float | None) -> bool:
    assert first_hz is not None
    assert second_hz is not None
    return abs(first_hz - second_hz) <= 1e-9 * abs(first_hz)


def _time(rate_hz: float | None) -> str:
    return "in continuous time" if rate_hz is None else f"sampled at {rate_hz:g} Hz"


def _in(unit: str) -> str:
    return f" {unit}" if unit else ""


def _number(who: str, name: str, value: Any) -> float:
    try:
        if np.ndim(value) or np.iscomplexobj(value):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{who}: '{name}' must be a number, got {value!r}.") from None
    if not np.isfinite(number):
        raise InputError(f"{who}: '{name}' must be finite, got {number}.")
    return number


def few_finite(values: NDArray[Any]) -> bool:
    """Return whether a few numbers are finite: as numbers of Python, where NumPy's own way takes several times as long.

    >>> few_finite(np.array([1.0, 2.0])), few_finite(np.array([1.0, np.inf]))
    (True, False)
    """
    return all(map(math.isfinite, values.tolist()))


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array, made read-only in place: values are immutable."""
    array.setflags(write=False)
    return array


def is_shape(value: Any) -> bool:
    """Return whether a setting is a shape over frequency rather than a number; an array of no dimension is a number."""
    if isinstance(value, np.ndarray):
        return cast(Any, value).ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str)


def over_frequency(who: str, name: str, shape: Any, logarithmic: bool) -> OfFrequency:
    """Return a shape as a function of frequency in Hz, linear over its logarithm, constant beyond its ends.

    Args:
        who: asks, for the sentence of a refusal.
        name: of the setting.
        shape: a number, or two sequences of frequencies in Hz, rising, and values.
        logarithmic: whether values are gains, returned in dB, and not dB already.

    Raises:
        InputError: neither, or gains that are not above zero.

    >>> at = over_frequency("me", "roof", ([10.0, 1000.0], [1.0, 100.0]), logarithmic=True)
    >>> at(np.array([0.0, 100.0, 5000.0])).round(9).tolist()
    [0.0, 20.0, 40.0]
    """
    if isinstance(shape, str):
        raise InputError(f"{who}: '{name}' must be a number or (frequencies in Hz, values), got the text {shape!r}.")
    if is_shape(shape):
        pair: Sequence[Any] = list(shape)
        if len(pair) != 2:
            raise InputError(f"{who}: '{name}' must be a number or (frequencies in Hz, values), got {shape!r}.")
        f, values = (real_array(who, name, np.atleast_1d(np.asarray(part)), 1) for part in pair)
        rising = f.size == values.size > 0 and f[0] > 0 and bool(np.all(np.diff(f) > 0))
        if not rising or (logarithmic and values.min() <= 0):
            what = "values above zero" if logarithmic else "values"
            raise InputError(f"{who}: '{name}' must be rising frequencies in Hz and as many {what}, got {shape!r}.")
    else:
        level = float(real_array(who, name, np.asarray(shape), 0))
        f, values = np.ones(1), np.array([positive(who, name, level) if logarithmic else level])
    values = 20 * np.log10(values) if logarithmic else values
    places = np.log(f)

    def at(f_hz: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.interp(np.log(np.asarray(f_hz, dtype=np.float64)), places, values)

    return at
