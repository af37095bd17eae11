"""What a strut's grey box is worth: its values, deviations and verdict."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify.grey_box.least_squares import Combination, Identifiability, Minimum
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.values import StateSpace, Status, StatusWord

# Relative misfit beyond which a fit without known noise is called poor.
POOR = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class StructuredFit:
    """Eq. (10) as the data tell it.

    Attributes:
        model: from command to reading, hold, filter and delay included.
        status: `ok`, `not white` (more is left than noise; deviations are then widened by what is left), `poor fit` or
            `not converged`.
        parameters: value of every symbol, SI units; the known ones as given.
        deviations: standard deviation of each; zero for known ones, infinite for those the data cannot tell alone.
        free: the symbols that were sought, in the order of the covariance.
        covariance: `(p, p)` of the free symbols; infinite on the diagonal, NaN beside it, where nothing is told.
        combinations: products of powers of the free symbols that are told, with their relative standard deviation.
        quantities: value and standard deviation of what any data tell: frequencies in Hz, damping, gain.
        polarity: +1, or -1 as eq. (10) is printed.
        delay: samples from command to first effect.
        error: RMS misfit as a share of the data.
        p_value: that the misfit is noise alone; NaN when the noise is not known.
        iterations: accepted steps.
    """

    model: StateSpace
    status: Status
    parameters: Mapping[str, float]
    deviations: Mapping[str, float]
    free: tuple[str, ...]
    covariance: FloatArray
    combinations: tuple[Combination, ...]
    quantities: Mapping[str, tuple[float, float]]
    polarity: int
    delay: int
    error: float
    p_value: float
    iterations: int


def physical(determined: Identifiability, sizes: FloatArray) -> FloatArray:
    """Return the covariance of the symbols themselves from that of their logarithms; `sizes` are their values."""
    covariance = determined.covariance * np.outer(sizes, sizes)
    covariance[determined.unbounded, :] = covariance[:, determined.unbounded] = np.nan
    covariance[np.diag_indices(sizes.size)] = np.where(determined.unbounded, np.inf, np.diag(covariance))
    return covariance


def verdict(
    bounds: Mapping[str, tuple[float, float]],
    minimum: Minimum,
    p_value: float,
    error: float,
    determined: Identifiability,
    noise_known: bool,
) -> Status:
    """Return what the fit is worth; `bounds` are those of the free symbols, in their order."""
    undetermined = [s for s, u in zip(bounds, determined.unbounded, strict=True) if u]
    aside = (
        f" The data cannot tell {', '.join(undetermined)} one by one (infinite deviations, kept near their guess), "
        f"only {len(determined.combinations)} combinations."
        if undetermined
        else ""
    )
    limits = np.log(list(bounds.values()))
    at_bound = [s for s, x, (low, high) in zip(bounds, minimum.x, limits, strict=True) if not low < x < high]
    if at_bound:
        aside += f" {', '.join(at_bound)} ended at a bound, where deviations do not hold."
    if not minimum.converged:
        return Status(
            StatusWord.NOT_CONVERGED, f"The search ended away from a minimum after {minimum.iterations} steps.{aside}"
        )
    if noise_known and p_value < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The response is missed by {100 * error:.2g} % (RMS), more than its noise ({p_in_words(p_value)}): eq. "
            f"(10) leaves part of it unexplained; deviations are widened by what is left.{aside}",
        )
    if not noise_known and error > POOR:
        return Status(
            StatusWord.POOR_FIT, f"The data are missed by {100 * error:.0f} % (RMS): eq. (10) does not hold.{aside}"
        )
    return Status(StatusWord.OK, f"Converged; the data are met within {100 * error:.2g} % (RMS).{aside}")
