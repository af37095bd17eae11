"""The scales in which a search works: one for all channels of an end where they share a unit, else each its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class SearchUnits:
    """What one unit of each channel of the search is in the plant's: Gs = diag(outputs) G diag(inputs)."""

    inputs: FloatArray
    outputs: FloatArray
    band_hz: tuple[float, float]

    @property
    def common(self) -> bool:
        """Whether all channels of an end have one scale, so that singular values are those of the plant's own units."""
        return bool(np.ptp(self.inputs) == 0 and np.ptp(self.outputs) == 0)

    @property
    def control(self) -> float:
        """What K S of the search is multiplied by to be in the plant's units, where all channels share them."""
        return float(self.inputs[0] * self.outputs[0])

    def scaled(self, plant: StateSpace) -> StateSpace:
        """Return a plant in the units of the search."""
        y, u = self.outputs[:, None], self.inputs
        return StateSpace(plant.A, plant.B * u, plant.C * y, plant.D * y * u, plant.rate_hz)

    def own(self, law: StateSpace) -> StateSpace:
        """Return a law of the search in the plant's units."""
        u, y = self.inputs[:, None], self.outputs
        return StateSpace(law.A, law.B * y, law.C * u, law.D * u * y, law.rate_hz)

    def taken(self, law: StateSpace) -> StateSpace:
        """Return a law of the plant in the units of the search."""
        u, y = self.inputs[:, None], self.outputs
        return StateSpace(law.A, law.B / y, law.C / u, law.D / u / y, law.rate_hz)


def units_of(plant: StateSpace, band_hz: tuple[float, float] | None, who: str, alike: bool) -> SearchUnits:
    """Return the scales of a plant.

    Args:
        plant: G.
        band_hz: over which it is evened out; its own when absent.
        who: asks, for the sentence of a refusal.
        alike: whether the law treats all channels alike, so that one scale an end is a must.
    """
    even = even_plant(plant, band_hz, who)
    band = even.band_hz if band_hz is None else (float(band_hz[0]), float(band_hz[1]))
    if alike or (_stated(plant.actuators) and _stated(plant.sensors)):
        # powers of two cost no digit
        inputs, outputs = (
            np.full(s.shape, np.exp2(np.round(np.median(np.log2(s))))) for s in (even.inputs, even.outputs)
        )
        return SearchUnits(inputs, outputs, band)
    return SearchUnits(even.inputs, even.outputs, band)


def _stated(wires: Sequence[object]) -> bool:
    """Return whether all channels of an end state the same unit."""
    return len({getattr(c, "unit", "") for c in wires}) == 1 and bool(getattr(wires[0], "unit", ""))
