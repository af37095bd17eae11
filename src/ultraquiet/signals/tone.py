"""A single sine."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive
from ultraquiet._base.registry import register
from ultraquiet.signals._abstract import Signal, amplitude, below_nyquist, clock

UNNAMED = 0.01  # of the rate: the frequency of a tone that names none


@register("signals", "tone")
@dataclass(frozen=True)
class Tone(Signal):
    """u(t) = amplitude sin(2 pi f t + phase): the paper's Fig. 10 at 60 Hz and 25 V.

    Args:
        frequency_hz: in Hz; a hundredth of the sampling rate when absent.
        amplitude_v: in the actuator's unit.
        phase_deg: at the first sample.

    Raises:
        InputError: an amplitude that is not finite, a frequency not above zero or not below half the sampling rate.

    >>> float(Tone(frequency_hz=60.0, amplitude_v=25.0).generate(samples=1, rate_hz=3500.0)[0])
    0.0
    """

    frequency_hz: float | None = None
    amplitude_v: float = 1.0
    phase_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.frequency_hz is not None:
            positive("Tone", "frequency_hz", self.frequency_hz, "Hz")
        amplitude("Tone", "amplitude_v", self.amplitude_v)
        between("Tone", "phase_deg", self.phase_deg, -360.0, 360.0, "degrees")

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the sine in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Tone", samples, rate_hz)
        frequency_hz = UNNAMED * rate if self.frequency_hz is None else self.frequency_hz
        below_nyquist("Tone", "frequency_hz", frequency_hz, rate)
        angle = 2.0 * np.pi * frequency_hz / rate * np.arange(n) + np.radians(self.phase_deg)
        return self.amplitude_v * np.sin(angle)
