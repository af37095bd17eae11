"""What a loop does to the direction that it attenuates least, and which directions its actuators do not reach."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import loudness
from ultraquiet.analyse.loop_response import band_attenuation, reached_directions
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace

WHO = "analyse"
ALIKE = 1e-6  # share of the largest: directions and growths that differ by less are told as the first of them
LINES = 60  # of the band, over which the directions out of reach are averaged
APART = 100.0  # between their own scales: channels of which no unit is known are not of one
LITTLE_DB = 0.05  # what a reader sees as none


@dataclass(frozen=True, eq=False)
class Scales:
    """What one unit of each channel is multiplied by before gains in several directions are compared.

    `even` where an end has channels of several units.
    """

    inputs: FloatArray
    outputs: FloatArray
    even: bool

    @property
    def command(self) -> float:
        """What a command per reading of the scaled plant is in the channels' units, where they share them."""
        return 1.0 if self.even else float(self.inputs[0] * self.outputs[0])

    def scaled(self, plant: StateSpace, law: StateSpace) -> tuple[StateSpace, StateSpace]:
        """Return plant and law between channels of these units."""
        y, u = self.outputs[:, None], self.inputs
        G = StateSpace(plant.A, plant.B * u, plant.C * y, plant.D * y * u, plant.rate_hz)
        K = StateSpace(law.A, law.B / self.outputs, law.C / u[:, None], law.D / u[:, None] / self.outputs, law.rate_hz)
        return G, K


@dataclass(frozen=True)
class WorstDirection:
    """The direction that a loop attenuates least over a band, of those that the actuators reach.

    Attributes:
        attenuation_db, f_hz: as `analyse.band_attenuation`; negative where it gets louder.
        band_hz: the band.
        reached: how many directions of the sensors the actuators reach, on most lines of the band.
        sensors: how many directions there are.
        least_reached: the sensor that has most of the other directions; empty where there are none.
        weighed: whether each sensor counts by its own scale, as sensors of several units do.
    """

    attenuation_db: float
    f_hz: float
    band_hz: tuple[float, float]
    reached: int
    sensors: int
    least_reached: str
    weighed: bool = False

    @property
    def sentences(self) -> str:
        """The same in words."""
        low, high = self.band_hz
        band = f"{low:.4g}-{high:.4g} Hz"
        if not self.reached:
            return f"Over {band} no actuator reaches any sensor: no law does anything there."
        if not np.isfinite(self.attenuation_db):
            return f"Over {band} nothing is known of the worst direction of S: the loop hangs on rounding errors."
        size = loudness(self.attenuation_db)
        if abs(self.attenuation_db) >= LITTLE_DB:
            size = f"{size}, at {self.f_hz:.4g} Hz"
        over = "Yet over" if self.attenuation_db <= -LITTLE_DB else "Over"
        scales = ", each sensor weighed by its own scale," if self.weighed else ""
        said = f"{over} {band} the worst direction of S{scales} gets {size}."
        return f"{said} {self._out_of_reach}" if self.least_reached else said

    @property
    def _out_of_reach(self) -> str:
        """Say which directions no law can quieten."""
        left = self.sensors - self.reached
        rest = "the other, most of it" if left == 1 else f"the other {left}, most of them"
        return (
            f"The actuators reach {self.reached} of {self.sensors} directions of the sensors; in {rest} sensor "
            f"{self.least_reached!r}, no law makes anything quieter."
        )


def scales_of(plant: StateSpace, inputs: FloatArray, outputs: FloatArray) -> Scales:
    """Return one scale for all channels of an end where they share a unit, else the plant's own.

    Channels without a word on their unit share one unless they answer as no two of one unit would.
    """
    ends = (plant.actuators, inputs), (plant.sensors, outputs)
    mixed = [_of_several_units(wires, own) for wires, own in ends]
    # powers of two cost no digit, and units decades away from one would
    u, y = (
        own if several else np.full(own.shape, np.exp2(np.round(np.median(np.log2(own)))))
        for several, (_, own) in zip(mixed, ends, strict=True)
    )
    return Scales(u, y, any(mixed))


def _of_several_units(wires: tuple[Channel, ...], own: FloatArray) -> bool:
    units = {c.unit for c in wires}
    return len(units) > 1 or (units == {""} and bool(own.max() > APART * own.min()))


def worst_direction(
    plant: StateSpace, controller: StateSpace, band_hz: tuple[float, float] | None = None
) -> WorstDirection:
    """Return `band_attenuation` in the scales of `analyse_loop`, and what of the sensors is out of reach.

    The directions that the inputs do not reach are those orthogonal to the range of G(f); with U of G = U s V' they
    have the share 1 - sum |U_i|^2 of sensor i, in the mean over the band.

    Args:
        plant: G.
        controller: K, its sign inside.
        band_hz: (low, high) in Hz; the plant's own when absent.

    Raises:
        InputError: as `analyse_loop`.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0], [0.1]], [[0.0], [0.0]], 100.0, ["coil"], ["near", "far"])
    >>> law = StateSpace([[0.0]], [[0.0, 0.0]], [[0.0]], [[-0.5, 0.0]], rate_hz=100.0)
    >>> worst_direction(G, law, (1.0, 5.0)).sentences.split("; ")[1]
    "in the other, most of it sensor 'far', no law makes anything quieter."

    Skogestad and Postlethwaite 2005, section 3.3 (directions), 6.3 (plants with more outputs than inputs).
    """
    own = even_plant(plant, band_hz, WHO)
    band = own.band_hz if band_hz is None else (float(band_hz[0]), float(band_hz[1]))
    return worst_in(scales_of(plant, own.inputs, own.outputs), plant, controller, band)


def worst_in(scales: Scales, plant: StateSpace, law: StateSpace, band_hz: tuple[float, float]) -> WorstDirection:
    """Return the same in scales in which directions are compared."""
    G, K = scales.scaled(plant, law)
    attenuation_db, at_hz = band_attenuation(G, K, band_hz)
    reached, least = _reach(G, band_hz, plant.sensors)
    weighed = bool(np.ptp(scales.outputs) > 0)  # what becomes of readings hangs on their own units alone
    return WorstDirection(attenuation_db, at_hz, band_hz, reached, len(plant.sensors), least, weighed)


def design_band(settings: Any, details: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the band that a design is for: its setting, its specification's, or that it took; None where none is."""
    given = getattr(settings, "band_hz", None)
    asked = getattr(details.get("specification"), "band_hz", None)
    return given or asked or details.get("band_hz")


def _reach(plant: StateSpace, band_hz: tuple[float, float], sensors: tuple[Channel, ...]) -> tuple[int, str]:
    """Return how many directions the inputs reach, and the sensor with the largest share of the others."""
    U = reached_directions(plant)(np.geomspace(*band_hz, LINES))
    power = np.abs(U) ** 2
    reached = int(np.median(power.sum(axis=(1, 2)).round()))
    if reached == len(sensors):
        return reached, ""
    share = 1 - power.sum(axis=2).mean(axis=0)
    return reached, strongest(share, sensors)


def strongest(direction: np.ndarray, wires: tuple[Channel, ...]) -> str:
    """Return the channel that a direction has most of, the first of those alike; empty for no direction."""
    if not direction.size:
        return ""
    size = np.abs(direction)
    return wires[int(np.flatnonzero(size >= (1 - ALIKE) * size.max())[0])].name
