"""From a realisation to a law in the code's own numbers."""

from functools import partial

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law.law import DTYPES, OVERRUN_LIMIT, Law, Rounded, open_end
from ultraquiet.deploy.law.realisation import Realisation

# Of each actuator's range: identification in closed loop leaves nine tenths to the control.
EXCITATION_SHARE = 0.1


def rounded(
    parts: Realisation,
    L: FloatArray | None,
    limits: FloatArray,
    precision: str,
    *,
    rate_hz: float,
    order: int,
    name: str = "controller",
    ramp_steps: int = 1,
    excitation: FloatArray | None = None,
    overrun_limit: int = OVERRUN_LIMIT,
) -> Law:
    """Return the realisation rounded to `precision`, to nearest; `excitation` is a tenth of the limits when absent.

    `limits` may be infinite: `open_end` stands there. What is smaller than every normal number of the type becomes
    zero.

    Raises:
        InputError: a coefficient that overflows in that precision.
    """
    cast = partial(nearest, precision=precision)
    ranges = _ranges(limits, precision)
    return Law(
        name=name,
        precision=precision,
        form=parts.form,
        blocks=tuple(cast(b) for b in parts.blocks),
        B=cast(parts.B),
        C=cast(parts.C),
        D=cast(parts.D),
        L=None if L is None else cast(L),
        limits=cast(ranges),
        ramp_steps=ramp_steps,
        rate_hz=rate_hz,
        order=order,
        channels=parts.channels,
        turn_in=None if parts.turn_in is None else cast(parts.turn_in),
        turn_out=None if parts.turn_out is None else cast(parts.turn_out),
        excitation=cast(EXCITATION_SHARE * ranges if excitation is None else excitation),
        overrun_limit=overrun_limit,
    )


def nearest(matrix: FloatArray, precision: str) -> Rounded:
    """Return a matrix in a precision's own numbers, rounded to nearest, read-only.

    Raises:
        InputError: a coefficient that overflows there.

    >>> nearest(np.array([0.1, 1e-40]), "float32").tolist()
    [0.10000000149011612, 0.0]
    """
    dtype = DTYPES[precision]
    with np.errstate(over="ignore"):
        numbers = np.ascontiguousarray(matrix, dtype=dtype)
    if not np.all(np.isfinite(numbers)):
        raise InputError(
            f"deploy: a coefficient of {np.abs(matrix).max():.1e} is beyond {precision}; scale the controller"
            " or take precision='float64'."
        )
    # A denormal number is zero on a processor that flushes them, and another one elsewhere: here it is zero.
    return frozen(np.where(np.abs(numbers) < np.finfo(dtype).tiny, dtype(0.0), numbers))


def _ranges(limits: FloatArray, precision: str) -> FloatArray:
    """Return limits that all are numbers of a precision, and stay ranges when they are rounded to it."""
    limits = np.where(np.isfinite(limits), limits, np.copysign(open_end(precision), limits))
    largest = float(np.finfo(DTYPES[precision]).max)
    limits = np.clip(limits, -largest, largest)  # what lies beyond all numbers of the type limits none of them
    ends = nearest(limits, precision)
    if not np.all(ends[:, 0] < ends[:, 1]):
        raise InputError(f"deploy: in {precision} an actuator's range in 'limits_v' is empty, got {limits.tolist()}.")
    return limits
