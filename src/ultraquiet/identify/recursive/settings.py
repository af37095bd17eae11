"""What the running estimator works from, below the methods that build it."""

from dataclasses import dataclass

import numpy as np

from ultraquiet.identify.prediction_error.race import Search
from ultraquiet.identify.prediction_error.structure import Structure

FORGETTING = ("exponential", "directional")


@dataclass(frozen=True)
class RecursionSettings:
    """The structure that is followed, and how its past is forgotten; `RecursiveMethod` says what each setting means."""

    structure: Structure
    search: Search
    offset: bool
    memory_s: float | None
    forgetting: str
    reset_s: float | None

    @property
    def linear(self) -> bool:
        """Whether the error is linear in the coefficients: no filters, no past to mend."""
        return self.structure.f == 0 and self.structure.c == 0

    def remembered(self, rate_hz: float) -> float:
        """Return by which factor the triangular root of the information shrinks at every sample."""
        return 1.0 if self.memory_s is None else float(np.exp(-0.5 / (rate_hz * self.memory_s)))

    def reset_samples(self, rate_hz: float) -> int:
        """Return the samples between resets; 0 for none."""
        return 0 if self.reset_s is None else max(1, round(self.reset_s * rate_hz))
