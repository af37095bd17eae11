"""A step up and down again."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, clock, level_of_either_sign

EDGES = (0.1, 0.6)  # of the signal, where none are named


@register("signals", "step")
@formerly(level_v="level")
@dataclass(frozen=True)
class Step(Signal):
    """u(t) = level for rise_s <= t < fall_s, else zero.

    Args:
        level: in the actuator's unit; one when absent, in a list
            a tenth of the actuator's range.
        rise_s, fall_s: times of the edges in seconds; an edge beyond the last sample does not appear. A tenth and six
            tenths of the signal when absent.

    Raises:
        InputError: a level that is not finite, edges out of order.

    >>> u = Step(level=10.0, rise_s=0.057, fall_s=0.687).generate(4096, 3500.0)
    >>> float(u[199]), float(u[200]), float(u[2404]), float(u[2405])
    (0.0, 10.0, 10.0, 0.0)
    """

    level: float | None = None
    rise_s: float | None = None
    fall_s: float | None = None

    levels = ("level",)

    def __post_init__(self) -> None:
        level_of_either_sign("Step", "level", self.level)
        if self.rise_s is not None:
            between("Step", "rise_s", self.rise_s, 0.0, float("inf"), "s")
        if self.rise_s is not None and self.fall_s is not None:
            _in_order(self.rise_s, self.fall_s)

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the step in the actuator's unit, `(samples,)`; the seed has no influence."""
        n, rate = clock("Step", samples, rate_hz)
        rise, fall = (
            share * n / rate if at is None else at for share, at in zip(EDGES, (self.rise_s, self.fall_s), strict=True)
        )
        _in_order(rise, fall)
        t = np.arange(n) / rate
        return np.where((t >= rise) & (t < fall), self.level_of("level"), 0.0)


def _in_order(rise_s: float, fall_s: float) -> None:
    if not rise_s < fall_s:
        raise InputError(f"Step: 'fall_s' of {fall_s:g} s must come after 'rise_s' of {rise_s:g} s.")
