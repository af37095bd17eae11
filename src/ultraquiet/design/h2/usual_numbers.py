"""The variances and the weight on u that nobody gave, measured by the plant and by those that are given."""

from dataclasses import dataclass

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.values.state_space import StateSpace

# Variance of sensor noise in that of the disturbance, as it shows at the outputs: 20 dB below it.
NOISE = 0.01
# The weight on u in the square of the plant's gain: control is cheap until it is 70 dB louder than what it moves.
CONTROL = 1e-7


@dataclass(frozen=True)
class UsualVariances:
    """What a quadratic cost asks of a plant where only some of its numbers are given.

    Args:
        loudness: typical gain of the plant over the band, output units per input unit.
        at_input: whether the disturbance enters at the plant's inputs.
    """

    loudness: float
    at_input: bool

    @classmethod
    def of(cls, plant: StateSpace, band_hz: tuple[float, float] | None, at_input: bool) -> "UsualVariances":
        """Return those of a plant over a band, its own where none is given."""
        return cls(even_plant(plant, band_hz).loudness, at_input)

    @property
    def control_weight(self) -> float:
        """Squared output units per squared input unit."""
        return CONTROL * self.loudness**2

    @property
    def shown(self) -> float:
        """What one unit of the disturbance's variance makes at the outputs."""
        return self.loudness**2 if self.at_input else 1.0

    def both(self, disturbance: float | None, sensor_noise: float | None) -> tuple[float, float]:
        """Return both variances, as given or the one as the other asks."""
        moved = self.disturbance(sensor_noise) if disturbance is None else disturbance
        return moved, self.sensor_noise(moved) if sensor_noise is None else sensor_noise

    def sensor_noise(self, disturbance: float) -> float:
        """Return the variance of sensor noise that goes with a disturbance."""
        return NOISE * disturbance * self.shown

    def disturbance(self, sensor_noise: float | None) -> float:
        """Return the variance of a disturbance that goes with a sensor noise; one where neither is given."""
        return 1.0 if sensor_noise is None else sensor_noise / (NOISE * self.shown)
