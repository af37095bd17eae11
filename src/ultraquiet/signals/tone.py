"""A single sine."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, below_nyquist, clock, level_of_either_sign

UNNAMED = 0.01  # of the rate: the frequency of a tone that names none


@register("signals", "tone")
@formerly(amplitude_v="amplitude")
@dataclass(frozen=True)
class Tone(Signal):
    """u(t) = amplitude sin(2 pi f t + phase).

    Args:
        frequency_hz: in Hz; a hundredth of the sampling rate when absent.
        amplitude: in the actuator's unit; one when absent, in a list
            a tenth of the actuator's range.
        phase_deg: at the first sample.

    Raises:
        InputError: an amplitude that is not finite, a frequency not above zero or not below half the sampling rate.

    >>> float(Tone(frequency_hz=60.0, amplitude=25.0).generate(samples=1, rate_hz=3500.0)[0])
    0.0
    """

    frequency_hz: float | None = None
    amplitude: float | None = None
    phase_deg: float = 0.0

    levels = ("amplitude",)

    def __post_init__(self) -> None:
        if self.frequency_hz is not None:
            positive("Tone", "frequency_hz", self.frequency_hz, "Hz")
        level_of_either_sign("Tone", "amplitude", self.amplitude)
        between("Tone", "phase_deg", self.phase_deg, -360.0, 360.0, "degrees")

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the sine in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Tone", samples, rate_hz)
        frequency_hz = UNNAMED * rate if self.frequency_hz is None else self.frequency_hz
        below_nyquist("Tone", "frequency_hz", frequency_hz, rate)
        angle = 2.0 * np.pi * frequency_hz / rate * np.arange(n) + np.radians(self.phase_deg)
        return self.level_of("amplitude") * np.sin(angle)
