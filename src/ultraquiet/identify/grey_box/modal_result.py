"""What a modal grey box is worth: its values, deviations and verdict."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify.grey_box.data import SpectralLines
from ultraquiet.identify.grey_box.least_squares import Minimum
from ultraquiet.identify.grey_box.modal_basis import SHARED, modes_of
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.values import StateSpace, Status, StatusWord

POOR = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalFit:
    """A modal grey box as the data tell it.

    Attributes:
        model: `(ny, nu)` from commands to readings, hold, filter and delay included.
        status: `ok`, `not white` (more is left than noise), `poor fit` or `not converged`.
        parameters: shared symbols and their values; `deviations` their standard deviations, zero for known ones.
        modes_hz, modes_damping: `(m,)` of the modes, by frequency, `modes_deviation` `(2, m)` of both.
        residues: `(k, ny, nu)`: that of the stack first, then R (and S where general) of the modes.
        covariance: `(p, p)` of the logarithms of `free`.
        free: names in the order of the covariance.
        error: RMS misfit of each channel as a share of its response, `(ny, nu)`.
        p_value: that the misfit is noise alone; NaN when the noise is not known.
        delay, iterations: samples from command to first effect; accepted steps.
        logarithms: of shared symbols and modes, in the order found: where a refit begins.
    """

    model: StateSpace
    status: Status
    parameters: Mapping[str, float]
    deviations: Mapping[str, float]
    modes_hz: FloatArray
    modes_damping: FloatArray
    modes_deviation: FloatArray
    residues: FloatArray
    covariance: FloatArray
    free: tuple[str, ...]
    error: FloatArray
    p_value: float
    delay: int
    iterations: int
    logarithms: FloatArray


def names(x: FloatArray) -> list[str]:
    """Return the names of all parameters."""
    modes = modes_of(x)
    return [*SHARED, *(n for k in range(modes) for n in (f"mode_{k + 1}_hz", f"mode_{k + 1}_damping"))]


def share(c: SpectralLines, e: FloatArray) -> float:
    """Return the RMS of an error as a share of the data."""
    n = c.f_hz.size
    error = np.hypot(e[:n], e[n:]) * c.deviation / np.sqrt(2.0)
    return float(np.linalg.norm(error) / np.linalg.norm(c.y))


def verdict(minimum: Minimum, p_value: float, error: FloatArray) -> Status:
    """Return what the fit is worth."""
    worst = 100 * float(error.max())
    if not minimum.converged:
        return Status(
            StatusWord.NOT_CONVERGED, f"The search ended away from a minimum after {minimum.iterations} steps."
        )
    if worst > 100 * POOR:
        return Status(
            StatusWord.POOR_FIT, f"A channel is missed by {worst:.0f} % (RMS): allow more modes or check the delay."
        )
    if p_value < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The response is missed by up to {worst:.2g} % (RMS), more than noise and floor ({p_in_words(p_value)}); "
            f"deviations are widened by what is left.",
        )
    return Status(StatusWord.OK, f"Converged; every channel is met within {worst:.2g} % (RMS).")
