"""Skyhook damping: a force against the absolute velocity of each strut, the geophone's corner taken back."""

from dataclasses import dataclass

from ultraquiet._base.constraints import one_of
from ultraquiet._base.registry import register
from ultraquiet.design.fixed_structure.classical import ClassicalMethod


@register("design", "skyhook")
@dataclass(frozen=True)
class Skyhook(ClassicalMethod):
    """Velocity feedback, u = gain C(s) y, y a geophone's signal: C makes it a velocity sensor of a lower corner.

    C = (s^2 + 2 zeta w s + w^2) / (s^2 + 2 zeta' w' s + w'^2), w the geophone's corner, w' the one wanted.

    Args:
        gain, high_pass_hz, low_pass_hz, tune, structure, specification, starts, seed: as in `LeadLag`.
        geophone_hz, geophone_zeta: corner and damping of the sensor; above its corner it measures velocity.
        corrected_hz, corrected_zeta: corner and damping wanted. An octave lower is honest: below, the
            sensor's noise grows with 40 dB a decade.

        actuator: `displacement` (a piezo stack: the command is the integral of the velocity) or `force`.
        leak_hz: below this corner the integral of `displacement` leaks.

    >>> from ultraquiet.values import StateSpace
    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> Skyhook().design(plant).status.ok
    True

    Karnopp, Crosby and Harwood 1974, doi:10.1115/1.3438373.
    """

    geophone_hz: float = 12.0
    geophone_zeta: float = 0.65
    corrected_hz: float = 5.0
    corrected_zeta: float = 0.7
    actuator: str = "displacement"
    leak_hz: float = 2.0

    def __post_init__(self) -> None:
        one_of("Skyhook", "actuator", self.actuator, ("displacement", "force"))
        super().__post_init__()

    def sections(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        """Return the correction of the geophone."""
        values = (self.geophone_hz, self.geophone_zeta, self.corrected_hz, self.corrected_zeta)
        correction = ("biquad", values, (True, False, True, False))
        return [correction, ("low-pass", (self.leak_hz,), (True,))] if self.actuator == "displacement" else [correction]
