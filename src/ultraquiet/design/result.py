"""What every design returns."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown import Shown, counted
from ultraquiet.design.weights.loop_weights import LoopWeights
from ultraquiet.values.controller import Controller
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

LITTLE_DB = 0.5  # of attenuation in the band: less is as good as no law
STABLE_WORDS = (StatusWord.OK, StatusWord.FRAGILE)  # of a loop that is stable with the design model


@dataclass(frozen=True, eq=False)
class Recovery:
    """How near a loop comes to its target L_t at one end: sigma(L - L_t) over `f_hz`, and the same over sigma(L_t)."""

    at: str
    f_hz: FloatArray
    error: FloatArray
    relative_error: FloatArray


@dataclass(frozen=True, eq=False)
class DesignResult(Shown):
    """The outcome of a design.

    Attributes:
        status: `ok`, or a word and a sentence about what went wrong.
        controller: u = K y, its sign inside; None when the design was refused. For a law that adapts, the linear law it
            is while its parameters stand still.
        law: what runs in the loop when that is not `controller`: an adaptive law, stepped sample by sample.
        gamma: the cost that the design claims for this controller (its norm where the method minimises one, else nan).
        achieved: the same cost computed again from the finished loop in the plant's own units.
        closed_loop_poles: eigenvalues of the loop with the design model, in z or rad/s.
        peak_sensitivity_db: largest singular value of S = (I - G K)^-1 over all frequencies.
        margins: loop-at-a-time margins at the plant's outputs and what else the method measured.
        residuals: relative residuals of the equations solved.
        details: everything else, by name.
        provenance: settings and parents.
    """

    status: Status
    controller: StateSpace | None
    gamma: float = float("nan")
    achieved: float = float("nan")
    closed_loop_poles: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=np.complex128))
    peak_sensitivity_db: float = float("nan")
    margins: Mapping[str, Any] = field(default_factory=dict)
    residuals: Mapping[str, float] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    law: Controller | None = None

    def _in_a_line(self) -> str:
        law = "no controller" if self.controller is None else f"law of {counted(self.controller.states, 'state')}"
        figures = {"gamma": self.gamma, "achieved": self.achieved, "peak sensitivity dB": self.peak_sensitivity_db}
        told = [f"{name} {value:.4g}" for name, value in figures.items() if np.isfinite(value)]
        return ", ".join([law, *told])

    @property
    def weights(self) -> Mapping[str, StateSpace] | None:
        """The weights that the cost was formed with, for a reduction to be judged by; None for a method without."""
        return self.details.get("weights")

    @property
    def loop_weights(self) -> LoopWeights | None:
        """The weights that the cost puts on S, T and KS themselves; None for a method that has none there."""
        table = self.details.get("loop_weights")
        return None if table is None else LoopWeights(**table)

    @property
    def norm_without_control(self) -> float | None:
        """The cost of doing nothing, where the method computes it."""
        return self.details.get("norm_without_control")

    @property
    def recovery(self) -> Recovery | None:
        """What loop transfer recovery came to, where the method recovers a loop."""
        table = self.details.get("recovery")
        return None if table is None else Recovery(**table)


class DesignMethod(Protocol):
    """A settings object with one verb."""

    def design(self, plant: StateSpace) -> DesignResult:
        """Return a controller u = K y for the plant."""
        ...


def refused(sentence: str, **details: Any) -> DesignResult:
    """Return a result without a controller."""
    return DesignResult(Status(StatusWord.REFUSED, sentence), None, details=details)


def is_stable(poles: ComplexArray, rate_hz: float | None) -> bool:
    """Return whether poles lie strictly inside the stability region."""
    return bool(np.all(poles.real < 0) if rate_hz is None else np.all(np.abs(poles) < 1))
