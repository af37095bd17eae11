"""One verdict on a model beside a record: what its comparison and its residual tests come to."""

from ultraquiet._base.shown.line import p_in_words
from ultraquiet.linalg import portmanteau
from ultraquiet.validate.compare import Comparison
from ultraquiet.validate.predict import Model
from ultraquiet.validate.residuals import ResidualTest
from ultraquiet.values import Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

# As of identification: a verdict errs once in a thousand good models.
SIGNIFICANCE = 1e-3


@takes_values
def verdict(model: Model, comparison: Comparison, residuals: ResidualTest | None = None) -> Status:
    """Return whether a model may be used for what the record shows.

    `unstable` where its simulation has no bound. With residuals `not white` where they are not white or not free of an
    input's past, p below 0.001 over all tests together (Sidak's correction). Without them, for a model that says
    nothing of noise, `poor fit` where the mean of an output would have served better than its simulation.

    Args:
        model: what is judged.
        comparison: the model's simulated outputs beside the recorded ones.
        residuals: tests of its one-step errors, where it has a model of the noise.

    >>> import numpy as np, ultraquiet as uq
    >>> gain = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], rate_hz=1.0)
    >>> verdict(gain, Comparison(np.zeros((1, 3)), np.array([-20.0]), (0,))).word
    'poor fit'
    """
    if not model.is_stable():
        return Status(StatusWord.UNSTABLE, "The model is unstable: its simulation grows without bound.")
    if residuals is None:
        worst = float(comparison.fit_percent.min())
        if worst < 0.0:
            return Status(
                StatusWord.POOR_FIT, f"The mean of an output serves better than its simulation (fit {worst:.2f} %)."
            )
        return Status(StatusWord.OK, f"The simulated fit is {worst:.2f} % at least; nothing is known of the noise.")
    p_values = {
        "not white": portmanteau.sidak(residuals.whiteness_p),
        "not free of an input's past": portmanteau.sidak(residuals.correlation_p.ravel()),
    }
    faults = [f"{what} ({p_in_words(p)})" for what, p in p_values.items() if not p >= SIGNIFICANCE / len(p_values)]
    if faults:
        return Status(StatusWord.NOT_WHITE, f"The residual is {' and '.join(faults)}: the model leaves it unexplained.")
    least = min(p_values.values())
    return Status(StatusWord.OK, f"The residual is white and free of the inputs (p = {least:.2g} at least).")
