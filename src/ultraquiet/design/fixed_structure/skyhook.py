"""Skyhook damping: a force against the absolute velocity at each sensor, the geophone's corner taken back."""

from dataclasses import dataclass

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet.design.fixed_structure.classical import ClassicalMethod


@register("design", "skyhook")
@dataclass(frozen=True)
class Skyhook(ClassicalMethod):
    """Velocity feedback, u = gain C(s) y, y a geophone's signal: C makes it a velocity sensor of a lower corner.

    C = (s^2 + 2 zeta w s + w^2) / (s^2 + 2 zeta' w' s + w'^2), w the geophone's corner, w' the one wanted.

    Args:
        gain, high_pass_hz, low_pass_hz, tune, structure, specification, starts, seed: as in `LeadLag`.
        geophone_hz, geophone_zeta: corner and damping of the sensor; above its corner it measures velocity. Without a
            corner the readings are velocities as they are, and nothing is corrected.
        corrected_hz, corrected_zeta: corner and damping wanted, an octave lower when absent: below, the sensor's noise
            grows with 40 dB a decade.
        actuator: `displacement` (a piezo stack: the command is the integral of the velocity) or `force`.
        leak_hz: below this corner the integral of `displacement` leaks.

    >>> from ultraquiet.values import StateSpace
    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> Skyhook().design(plant).status.ok
    True

    Karnopp, Crosby and Harwood 1974, doi:10.1115/1.3438373.
    """

    geophone_hz: float | None = None
    geophone_zeta: float = 0.7
    corrected_hz: float | None = None
    corrected_zeta: float = 0.7
    actuator: str = "displacement"
    leak_hz: float = 2.0

    def __post_init__(self) -> None:
        one_of("Skyhook", "actuator", self.actuator, ("displacement", "force"))
        if self.corrected_hz is not None and self.geophone_hz is None:
            raise InputError("Skyhook: 'corrected_hz' moves a geophone's corner; give that as 'geophone_hz'.")
        super().__post_init__()

    def sections(self) -> list[tuple[str, tuple[float, ...], tuple[bool, ...]]]:
        """Return the correction of the geophone and the integral of the command, where they are wanted."""
        found: list[tuple[str, tuple[float, ...], tuple[bool, ...]]] = []
        if self.geophone_hz is not None:
            wanted_hz = self.geophone_hz / 2 if self.corrected_hz is None else self.corrected_hz
            values = (self.geophone_hz, self.geophone_zeta, wanted_hz, self.corrected_zeta)
            found.append(("biquad", values, (True, False, True, False)))
        return [*found, ("low-pass", (self.leak_hz,), (True,))] if self.actuator == "displacement" else found
