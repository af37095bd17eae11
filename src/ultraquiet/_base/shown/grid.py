"""Frequencies on which a model shows all it has."""

from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

DECADES, LINES = 3.0, 240  # below half the rate, or about the poles of a system in continuous time
TINY = np.finfo(float).tiny


class Responding(Protocol):
    """Anything with a rate and a frequency response."""

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz, None for continuous time."""
        ...

    def frequency_response(self, f_hz: Any) -> ComplexArray:
        """Return the response `(ny, nu, nf)`."""
        ...


def shown_frequencies(model: Responding, lines: int = LINES) -> FloatArray:
    """Return `(nf,)` frequencies in Hz to draw a model on, evenly spaced in decades.

    Of a sampled model three decades below half its rate and down to a third of its slowest pole; of a continuous one a
    decade to each side of its poles.
    """
    poles = np.abs(np.asarray(_poles_hz(model)))
    poles = poles[np.isfinite(poles) & (poles > TINY)]
    if model.rate_hz is None:
        low, high = (poles.min() / 10, poles.max() * 10) if poles.size else (0.1, 100.0)
    else:
        high = model.rate_hz / 2
        slowest = poles[poles > high * 1e-6]
        low = min([high / 10**DECADES, *(slowest[:1] if slowest.size == 0 else [float(slowest.min()) / 3])])
    return np.geomspace(float(low), float(high), lines)


def gain_curve(model: Responding) -> tuple[str, FloatArray]:
    """Return a name and the gain of the first channel in dB, `(nf,)`."""
    f_hz = shown_frequencies(model, 80)
    gain = np.abs(model.frequency_response(f_hz)[:1, :1].ravel())
    return f"gain, {f_hz[0]:.3g} to {f_hz[-1]:.3g} Hz", 20.0 * np.log10(np.maximum(gain, TINY))


def _poles_hz(model: Any) -> FloatArray:
    """Return the sizes of the poles of a system in Hz; those of a matrix of models are not asked for."""
    if not hasattr(model, "A"):
        return np.zeros(0)
    poles = model.poles()
    if model.rate_hz is not None:
        poles = np.log(poles[poles != 0].astype(np.complex128)) * model.rate_hz
    return np.abs(poles) / (2 * np.pi)
