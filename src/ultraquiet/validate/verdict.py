"""One verdict on a model beside a record: what its comparison and its residual tests come to."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.linalg import portmanteau
from ultraquiet.validate.compare import Comparison
from ultraquiet.validate.predict import Model
from ultraquiet.validate.residuals import ResidualTest
from ultraquiet.values import Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

# As of identification: a verdict errs once in a thousand good models.
SIGNIFICANCE = 1e-3
# An error 100 dB below its output is none of a measurement: what is left is rounding, neither white nor free of inputs.
EXACT_PERCENT = 100.0 * (1.0 - 1e-5)


@takes_values
def verdict(model: Model, comparison: Comparison, residuals: ResidualTest | None = None) -> Status:
    """Return whether a model may be used for what the record shows.

    `unstable` where its simulation has no bound, `poor fit` where that says nothing of an output. With residuals of one
    step `not white` where they are not white or not free of an input's past, p below 0.001 over all tests together
    (Sidak's correction); with simulated ones where they are not free of the inputs. Where these are simulated, or there
    are none, `poor fit` too where the mean of an output would have served better than its simulation.

    Args:
        model: what is judged.
        comparison: the model's simulated outputs beside the recorded ones.
        residuals: of `residual_test` or `state_space_test`; without them nothing is said of the error.

    >>> import numpy as np, ultraquiet as uq
    >>> gain = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], rate_hz=1.0)
    >>> verdict(gain, Comparison(np.zeros((1, 3)), np.array([-20.0]), (0,))).word
    'poor fit'
    """
    if not model.is_stable():
        return Status(StatusWord.UNSTABLE, "The model is unstable: its simulation grows without bound.")
    simulates = residuals is None or residuals.simulated
    missed = poor_fit(comparison.fit_percent, 0.0 if simulates else -np.inf)
    if missed is not None:
        return missed
    worst = float(comparison.fit_percent.min())
    if residuals is None:
        return Status(
            StatusWord.OK,
            f"The simulated fit is {worst:.2f} % at least; whether its error is free of the inputs was not asked.",
        )
    noisy = comparison.fit_percent < EXACT_PERCENT
    if not noisy.any():
        return Status(StatusWord.OK, f"The simulated fit is {worst:.6g} % at least: the record holds no noise to test.")
    return _of_simulation(residuals, noisy, worst) if simulates else _of_one_step(residuals, noisy)


def poor_fit(fit_percent: FloatArray, least: float = 0.0, names: Sequence[str] = ()) -> Status | None:
    """Return `poor fit` where a simulated fit is no number or below `least` percent, None where all may be right.

    Args:
        fit_percent: `(ny,)` of a stable model.
        least: 0 asks for more than the mean of an output gives.
        names: of the outputs.
    """
    worst = int(np.argmin(np.where(np.isnan(fit_percent), -np.inf, fit_percent)))
    fit, named = float(fit_percent[worst]), f" '{names[worst]}'" if names else ""
    if not np.isfinite(fit):
        return Status(
            StatusWord.POOR_FIT,
            f"Output{named or f' {worst + 1}'} does not move through the record, its simulation does: see that its "
            f"sensor is not stuck.",
        )
    if fit >= least:
        return None
    whose = f"output{named}" if named else "an output"
    return Status(StatusWord.POOR_FIT, f"The mean of {whose} serves better than its simulation (fit {fit:.2f} %).")


def _of_simulation(residuals: ResidualTest, noisy: np.ndarray, worst: float) -> Status:
    free = portmanteau.sidak(residuals.correlation_p[noisy].ravel())
    if not free >= SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The simulated error still follows the inputs ({p_in_words(free)}): the model leaves it unexplained.",
        )
    return Status(
        StatusWord.OK,
        f"The simulated fit is {worst:.2f} % at least, and its error is free of the inputs ({p_in_words(free)}).",
    )


def _of_one_step(residuals: ResidualTest, noisy: np.ndarray) -> Status:
    p_values = {
        "not white": portmanteau.sidak(residuals.whiteness_p[noisy]),
        "not free of an input's past": portmanteau.sidak(residuals.correlation_p[noisy].ravel()),
    }
    faults = [f"{what} ({p_in_words(p)})" for what, p in p_values.items() if not p >= SIGNIFICANCE / len(p_values)]
    if faults:
        return Status(StatusWord.NOT_WHITE, f"The residual is {' and '.join(faults)}: the model leaves it unexplained.")
    least = min(p_values.values())
    return Status(StatusWord.OK, f"The residual is white and free of the inputs (p = {least:.2g} at least).")
