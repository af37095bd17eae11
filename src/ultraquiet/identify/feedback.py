"""Errors and the inputs of their own sample, which in a loop answer them."""

from collections.abc import Callable

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.linalg import portmanteau

FED_BACK = 0.01  # level at which inputs after the errors show a loop


def unless_answered(free: float, delayed: Callable[[], float], fed_back: Callable[[], float]) -> float:
    """Return the p-value that errors of a model without feedthrough hold nothing of the inputs.

    Where inputs of their own sample alone decide, and later ones show that they come from a loop, a law without delay
    may have made these of the errors: they are left out. Without a loop they tell of a feedthrough that is missed.

    Args:
        free: p-value of all inputs.
        delayed: p-value of those of samples before.
        fed_back: p-value that inputs hold nothing of the errors before them.
    """
    if free >= SIGNIFICANCE:
        return free
    before = delayed()
    return before if before >= SIGNIFICANCE and fed_back() < FED_BACK else free


def free_of_inputs(e: FloatArray, inputs: FloatArray, lags: int, delayed: bool) -> float:
    """Return the p-value that white errors `(n,)` hold nothing of inputs `(nu, n)` within `lags` samples.

    `delayed` is whether every input of the model takes a sample to its first effect.
    """
    free = portmanteau.free_of_inputs(e, inputs, lags)
    if not delayed:
        return free
    return unless_answered(
        free,
        lambda: portmanteau.free_of_inputs(e, inputs, lags, delayed=True),
        lambda: portmanteau.fed_back(e, inputs).p_value,
    )


def free_of_inputs_in(r: FloatArray, n: int, delayed: bool) -> float:
    """Return the same from means over n samples of z(t) z(t + k)', k from zero, z = [e, inputs]."""

    def free(first: int) -> float:
        return portmanteau.sidak(
            portmanteau.cross_correlation_of(r[first:, j, 0], r[: len(r) - first, j, j], r[:1, 0, 0], n).p_value
            for j in range(1, r.shape[1])
        )

    if not delayed:
        return free(0)
    return unless_answered(free(0), lambda: free(1), lambda: portmanteau.fed_back_of(r, n).p_value)
