"""Why a loop is not stable: poles that grow, or poles on the boundary of stability that the law does not hold."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.shown.line import hertz
from ultraquiet.design.stabilisability import lost_modes
from ultraquiet.values.state_space import StateSpace

ALIKE = 1e-6  # of the sampling rate, or of the fastest pole: poles this near each other are one
STILL = 1e-7  # radians per sample, below which a pole on the unit circle is an integrator's


def unstable(plant: StateSpace, controller: StateSpace, loop: StateSpace, name: str = "loop") -> str:
    """Return one sentence or more, without its end, on a loop that is not stable.

    Args:
        plant: G.
        controller: K.
        loop: both closed, from anywhere to anywhere.
        name: of the loop, after "The".
    """
    f_hz = np.unique(np.where(loop.boundary_hz() <= _still_hz(loop), 0.0, loop.boundary_hz()))
    if not f_hz.size or _grows(loop):
        return f"The {name} is unstable"
    where = ", ".join(f"{hertz(f)} (an integrator)" if f == 0 else hertz(f) for f in f_hz)
    which = "a pole" if f_hz.size == 1 else "poles"
    stand = "stands" if f_hz.size == 1 else "stand"
    return (
        f"The {name} is not stable: {which} at {where} {stand} on the boundary of stability as far as the digits tell, "
        f"so a lasting disturbance there makes it grow without end. {_cause(plant, controller, loop, f_hz)}"
    )


def _cause(plant: StateSpace, controller: StateSpace, loop: StateSpace, f_hz: FloatArray) -> str:
    """Return whose the poles are, and what would do."""
    if _among(f_hz, plant.boundary_hz(), loop):
        hidden = lost_modes("What no law holds", plant)
        if hidden:
            return hidden.removesuffix(".")
        return (
            "That is the plant's own mode, and the law does not hold it, for it has a zero there; ask for action at "
            "that frequency by a weight or a wider band, or take the mode out of the plant"
        )
    if _among(f_hz, controller.boundary_hz(), loop):
        return (
            "That is the law's own mode, and the plant does not hold it, for it passes nothing there; let the mode "
            "leak, or take it out of the law"
        )
    return "The law itself brings the loop to this verge; ask for less, or for a larger margin"


def _grows(loop: StateSpace) -> bool:
    """Return whether a pole is outside, away from those on the boundary."""
    poles, turns = loop.poles(), 2 * np.pi * loop.boundary_hz()
    if loop.rate_hz is None:
        points = 1j * turns
        outside = poles[poles.real >= 0]
    else:
        points = np.exp(1j * turns / loop.rate_hz)
        outside = poles[np.abs(poles) >= 1]
    apart = np.abs(outside.real + 1j * np.abs(outside.imag) - points[:, None])
    return bool((apart.min(axis=0) > ALIKE * _scale(poles, loop.rate_hz)).any())


def _scale(poles: ComplexArray, rate_hz: float | None) -> float:
    return float(np.abs(poles).max(initial=0.0)) if rate_hz is None else 1.0


def _among(f_hz: FloatArray, own_hz: FloatArray, loop: StateSpace) -> bool:
    """Return whether one of the frequencies is one of a part's own."""
    widest = loop.rate_hz or _scale(loop.poles(), None) / (2 * np.pi)
    return bool((np.abs(f_hz[:, None] - own_hz) <= ALIKE * widest).any())


def _still_hz(loop: StateSpace) -> float:
    return 0.0 if loop.rate_hz is None else STILL * loop.rate_hz / (2 * np.pi)
