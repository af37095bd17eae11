"""A sine whose frequency rises while its amplitude falls."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.registry import register
from ultraquiet.signals._abstract import Signal, amplitude, below_nyquist, clock


@register("signals", "chirp")
@dataclass(frozen=True)
class Chirp(Signal):
    """u(t) = a(t) sin(2 pi int f dt), f and a linear in time: the paper's Fig. 6.

    Args:
        start_hz, stop_hz: first and last frequency in Hz; falling sweeps are allowed.
        start_v, stop_v: first and last amplitude, in the actuator's unit.

    Raises:
        InputError: an amplitude that is not finite, a frequency not above zero or not below half the sampling rate.

    >>> u = Chirp(start_hz=5, stop_hz=100).generate(samples=4096, rate_hz=3500.0)
    >>> u.shape, float(abs(u).max()) <= 25.0
    ((4096,), True)

    Reference: section 3.3 and Fig. 6 of the paper.
    """

    start_hz: float = 5.0
    stop_hz: float = 100.0
    start_v: float = 25.0
    stop_v: float = 5.0

    def __post_init__(self) -> None:
        positive("Chirp", "start_hz", self.start_hz, "Hz")
        positive("Chirp", "stop_hz", self.stop_hz, "Hz")
        amplitude("Chirp", "start_v", self.start_v)
        amplitude("Chirp", "stop_v", self.stop_v)

    def generate(self, samples: int = 4096, rate_hz: float = 3500.0, seed: int = 0) -> FloatArray:
        """Return the sweep over all `samples` in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Chirp", samples, rate_hz)
        below_nyquist("Chirp", "stop_hz", max(self.start_hz, self.stop_hz), rate)
        t = np.arange(n) / n
        cycles = (self.start_hz * t + 0.5 * (self.stop_hz - self.start_hz) * t**2) * (n / rate)
        return (self.start_v + (self.stop_v - self.start_v) * t) * np.sin(2.0 * np.pi * cycles)
