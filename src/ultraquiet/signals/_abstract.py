"""What every test signal shares: the checks and the spectrum.

Settings that end in `_v` are in the unit of the actuator that is driven, whatever it is; what an actuator can take is
known by its channel, and an experiment that exceeds it is refused before anything moves.
"""

from abc import ABC, abstractmethod

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError

# Section 3.3 of the paper: its test signals stay inside +-25 V, beyond that its sensors saturate; no limit of others.
MAXIMUM_V = 25.0


# Share of the sampling rate below which anti-alias filters usually pass: the band of a signal that names no edge.
ALIAS_FREE = 0.4


class Signal(ABC):
    """A test signal. Subclasses are frozen dataclasses of settings."""

    @abstractmethod
    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the signal in the actuator's unit, `(samples,)`."""

    def spectrum(self, samples: int, rate_hz: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return frequencies in Hz and the one-sided power spectral density in unit^2/Hz, `(samples // 2 + 1,)` each.

        S(f_k) = 2 |U_k|^2 / (rate n), the periodogram without window; its sum times rate / n is the mean square.

        >>> from ultraquiet.signals import Tone
        >>> f_hz, psd = Tone(frequency_hz=50.0, amplitude_v=2.0).spectrum(samples=3500, rate_hz=3500.0)
        >>> float(f_hz[psd.argmax()]), round(float(psd.sum() * (f_hz[1] - f_hz[0])), 6)
        (50.0, 2.0)
        """
        u = self.generate(samples, rate_hz, seed)
        psd = np.abs(np.fft.rfft(u)) ** 2 / (rate_hz * u.size)
        # Zero frequency, and Nyquist when there is one, have no mirror image to fold in.
        psd[1 : (u.size + 1) // 2] *= 2.0
        return np.asarray(np.arange(psd.size) * (rate_hz / u.size), dtype=np.float64), psd.astype(np.float64)


def amplitude(who: str, name: str, value: float) -> float:
    """Return a finite number, of either sign."""
    return between(who, name, value, -np.inf, np.inf)


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
