"""The numbers of weights that nobody gave, measured by the plant: in its units, about its own band."""

from dataclasses import dataclass

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.values.state_space import StateSpace

# Of weights in numbers: W1 over the band, outside it, and noise at the sensors. None of them hangs on a unit.
HEIGHT, FLOOR, NOISE = 12.0, 0.6, 1.0
# K S may have so many times the gain that undoes the plant's: 54 dB of loop gain.
CONTROL = 500.0
# Where control becomes dear, where the loop is to end, and where the four-block weight on u rises, by the band's end.
DEAR, LOOP_ENDS, RISES = 4.0, 5.0, 0.28
# Disturbance at the inputs: its answer is so much of the noise at the sensors.
DISTURBANCE = 0.1


@dataclass(frozen=True)
class UsualNumbers:
    """What weights in numbers ask of a plant where only some of them are given.

    Args:
        loudness: typical gain of the plant over the band, output units per input unit.
        end_hz: upper end of the band.
    """

    loudness: float
    end_hz: float

    @classmethod
    def of(cls, plant: StateSpace, band_hz: tuple[float, float] | None) -> "UsualNumbers":
        """Return those of a plant over a band, its own where none is given."""
        even = even_plant(plant, band_hz)
        return cls(even.loudness, even.band_hz[1])

    @property
    def control_limit(self) -> float:
        """Largest wanted gain of K S, input units per output unit."""
        return CONTROL / self.loudness

    @property
    def control_hz(self) -> float:
        """From where on less of it is wanted."""
        return DEAR * self.end_hz

    @property
    def roll_off_hz(self) -> float:
        """Where the loop is to end."""
        return LOOP_ENDS * self.end_hz

    @property
    def rise_hz(self) -> float:
        """Where the weight on u of the four-block form begins to rise."""
        return RISES * self.end_hz

    def disturbance(self, noise: float) -> float:
        """Return the disturbance at every input that goes with a noise at every sensor."""
        return DISTURBANCE * noise / self.loudness

    def noise(self, disturbance: float | None) -> float:
        """Return the noise at every sensor that goes with a disturbance at every input; one where neither is given."""
        return NOISE if disturbance is None else disturbance * self.loudness / DISTURBANCE
