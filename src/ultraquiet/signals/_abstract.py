"""What every test signal shares: its levels, the checks and the spectrum.

Levels are in the unit of the actuator that is driven, whatever it is; what an actuator can take is known by its
channel, and an experiment that exceeds it is refused before anything moves.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError

# Section 3.3 of the paper: its test signals stay inside +-25 V, beyond that its sensors saturate; no limit of others.
MAXIMUM_V = 25.0


UNNAMED_LEVEL = 1.0  # of an actuator that nothing is known of, in its unit

# Share of the sampling rate below which anti-alias filters usually pass: the band of a signal that names no edge.
ALIAS_FREE = 0.4


class Signal(ABC):
    """A test signal. Subclasses are frozen dataclasses of settings; `levels` names those in the actuator's unit."""

    levels: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the signal in the actuator's unit, `(samples,)`."""

    def unnamed_levels(self) -> tuple[str, ...]:
        """Return the names of the levels that nobody named."""
        return tuple(name for name in self.levels if getattr(self, name) is None)

    def at(self, level: float) -> Self:
        """Return the signal with `level`, in the actuator's unit, wherever it names none.

        >>> from ultraquiet.signals import Chirp
        >>> Chirp(start_level=5.0).at(2.0)
        Chirp(start_level=5, stop_level=2)
        """
        unnamed = dict.fromkeys(self.unnamed_levels(), level)
        return replace(self, **unnamed) if unnamed else self  # type: ignore[type-var]

    def level_of(self, name: str) -> float:
        """Return a level; one of the actuator's unit where it has none."""
        level = getattr(self, name)
        return UNNAMED_LEVEL if level is None else float(level)

    def spectrum(self, samples: int, rate_hz: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return frequencies in Hz and the one-sided power spectral density in unit^2/Hz, `(samples // 2 + 1,)` each.

        S(f_k) = 2 |U_k|^2 / (rate n), the periodogram without window; its sum times rate / n is the mean square.

        >>> from ultraquiet.signals import Tone
        >>> f_hz, psd = Tone(frequency_hz=50.0, amplitude=2.0).spectrum(samples=3500, rate_hz=3500.0)
        >>> float(f_hz[psd.argmax()]), round(float(psd.sum() * (f_hz[1] - f_hz[0])), 6)
        (50.0, 2.0)
        """
        u = self.generate(samples, rate_hz, seed)
        psd = np.abs(np.fft.rfft(u)) ** 2 / (rate_hz * u.size)
        # Zero frequency, and Nyquist when there is one, have no mirror image to fold in.
        psd[1 : (u.size + 1) // 2] *= 2.0
        return np.asarray(np.arange(psd.size) * (rate_hz / u.size), dtype=np.float64), psd.astype(np.float64)


def level_of_either_sign(who: str, name: str, value: float | None) -> None:
    """Refuse a level that is no finite number; one that is not named comes later."""
    if value is not None:
        between(who, name, value, -np.inf, np.inf)


def level_above_zero(who: str, name: str, value: float | None) -> None:
    """Refuse a level that is not above zero; one that is not named comes later."""
    if value is not None:
        positive(who, name, value)


def clock(who: str, samples: int, rate_hz: float) -> tuple[int, float]:
    """Return the checked number of samples and rate."""
    return whole(who, "samples", samples, 1), positive(who, "rate_hz", rate_hz, "Hz")


def draws(who: str, seed: int) -> np.random.Generator:
    """Return the generator of a signal's random draws."""
    return np.random.default_rng(whole(who, "seed", seed, 0))


def upper_hz(stop_hz: float | None, rate_hz: float) -> float:
    """Return the upper edge asked for; without one, as far as anti-alias filters usually let through."""
    return ALIAS_FREE * rate_hz if stop_hz is None else stop_hz


def below_nyquist(who: str, name: str, f_hz: float, rate_hz: float) -> None:
    """Refuse a frequency that the sampling rate cannot carry."""
    if not f_hz < rate_hz / 2:
        raise InputError(
            f"{who}: '{name}' of {f_hz:g} Hz must lie below half the sampling rate, {rate_hz / 2:g} Hz; "
            "lower it or sample faster."
        )


def band(who: str, start_hz: float, stop_hz: float | None) -> None:
    """Refuse a band that is empty or begins below zero; an upper edge that is not named comes later."""
    if stop_hz is None:
        between(who, "start_hz", start_hz, 0.0, float("inf"), "Hz")
        return
    if not 0 <= start_hz < stop_hz < float("inf"):
        raise InputError(f"{who}: the band must satisfy 0 <= start_hz < stop_hz, got {start_hz:g} to {stop_hz:g} Hz.")
