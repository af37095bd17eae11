"""A step up and down again."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet.signals._abstract import Signal, amplitude, clock


@register("signals", "step")
@dataclass(frozen=True)
class Step(Signal):
    """u(t) = level for rise_s <= t < fall_s, else zero: the paper's Fig. 8.

    Args:
        level_v: the level, in the actuator's unit.
        rise_s, fall_s: times of the edges in seconds; an edge beyond the last sample does not appear.

    Raises:
        InputError: a level that is not finite, edges out of order.

    >>> u = Step(level_v=10.0).generate()
    >>> float(u[199]), float(u[200]), float(u[2404]), float(u[2405])
    (0.0, 10.0, 10.0, 0.0)
    """

    level_v: float = 10.0
    rise_s: float = 0.057
    fall_s: float = 0.687

    def __post_init__(self) -> None:
        amplitude("Step", "level_v", self.level_v)
        between("Step", "rise_s", self.rise_s, 0.0, float("inf"), "s")
        if not self.rise_s < self.fall_s:
            raise InputError(f"Step: 'fall_s' of {self.fall_s:g} s must come after 'rise_s' of {self.rise_s:g} s.")

    def generate(self, samples: int = 4096, rate_hz: float = 3500.0, seed: int = 0) -> FloatArray:
        """Return the step in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Step", samples, rate_hz)
        t = np.arange(n) / rate
        return np.where((t >= self.rise_s) & (t < self.fall_s), float(self.level_v), 0.0)
