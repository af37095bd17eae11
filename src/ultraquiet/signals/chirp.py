"""A sine whose frequency rises while its amplitude falls."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, below_nyquist, clock, level_of_either_sign, upper_hz


@register("signals", "chirp")
@formerly(start_v="start_level", stop_v="stop_level")
@dataclass(frozen=True)
class Chirp(Signal):
    """u(t) = a(t) sin(2 pi int f dt), f and a linear in time.

    Args:
        start_hz, stop_hz: first and last frequency in Hz; falling sweeps are allowed. One period of the whole signal
            and 0.4 of the rate when absent.
        start_level, stop_level: first and last amplitude, in the actuator's unit; one when absent, in a list
            a tenth of the actuator's range.

    Raises:
        InputError: an amplitude that is not finite, a frequency not above zero or not below half the sampling rate.

    >>> u = Chirp(start_hz=5, stop_hz=100, start_level=25).generate(samples=4096, rate_hz=3500.0)
    >>> u.shape, float(abs(u).max()) <= 25.0
    ((4096,), True)

    Reference: section 3.3 and Fig. 6 of the paper.
    """

    start_hz: float | None = None
    stop_hz: float | None = None
    start_level: float | None = None
    stop_level: float | None = None

    levels = ("start_level", "stop_level")

    def __post_init__(self) -> None:
        for name in ("start_hz", "stop_hz"):
            if getattr(self, name) is not None:
                positive("Chirp", name, getattr(self, name), "Hz")
        for name in self.levels:
            level_of_either_sign("Chirp", name, getattr(self, name))

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the sweep over all `samples` in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Chirp", samples, rate_hz)
        start, stop = rate / n if self.start_hz is None else self.start_hz, upper_hz(self.stop_hz, rate)
        below_nyquist("Chirp", "stop_hz" if stop >= start else "start_hz", max(start, stop), rate)
        t = np.arange(n) / n
        cycles = (start * t + 0.5 * (stop - start) * t**2) * (n / rate)
        first, last = (self.level_of(name) for name in self.levels)
        return (first + (last - first) * t) * np.sin(2.0 * np.pi * cycles)
