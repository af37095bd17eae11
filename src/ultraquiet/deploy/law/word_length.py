"""How many bits a controller's coefficients need, form by form."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law.form_choice import error_of
from ultraquiet.deploy.law.realisation import FORMS, Realisation, realisation
from ultraquiet.values.state_space import StateSpace

SIGNIFICANT = (8, 12, 16, 20, 24)  # 24: float32, and the TMS320C31's own format


def rounding_errors(
    controller: StateSpace, bits: Sequence[int] = SIGNIFICANT, plant: StateSpace | None = None
) -> dict[str, FloatArray]:
    """Return for each form the largest relative error of the response at each number of significant bits.

    A coefficient c becomes 2^(e - b) round(c 2^(b - e)), 2^(e - 1) <= |c| < 2^e: a float of b significant bits and any
    exponent. What the error means is said in `ultraquiet.deploy.law.form_choice.error_of`.

    Args:
        controller: discrete law from measurements to commands.
        bits: numbers of significant bits, 1 to 53.
        plant: when given, the error is that of the loop's sensitivity; infinite where the loop becomes unstable.

    Returns:
        form -> `(bits,)` errors; a form that the law does not have is left out.

    Raises:
        InputError: a law in continuous time, a number of bits out of range.

    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> errors = rounding_errors(law, bits=(12, 24))["modal"]
    >>> bool(errors[1] < 1e-3 * errors[0])
    True
    """
    if controller.rate_hz is None:
        raise InputError("rounding_errors: the controller is in continuous time; discretise it first.")
    widths = [whole("rounding_errors", "bits", b, 1, 53) for b in bits]
    errors: dict[str, FloatArray] = {}
    for form in FORMS:
        try:
            parts = realisation(controller, form)
        except InputError:
            continue
        rounded = [_state_space(parts, b, controller.rate_hz) for b in widths]
        errors[form] = np.array([error_of(law, controller, plant) for law in rounded])
    return errors


def _state_space(parts: Realisation, bits: int, rate_hz: float) -> StateSpace:
    blocks = tuple(_round(block, bits) for block in parts.blocks)
    B, C, D = (_round(matrix, bits) for matrix in (parts.B, parts.C, parts.D))
    turns = (None if T is None else _round(T, bits) for T in (parts.turn_in, parts.turn_out))
    rounded = replace(parts, blocks=blocks, B=B, C=C, D=D, **dict(zip(("turn_in", "turn_out"), turns, strict=True)))
    return rounded.state_space(rate_hz)


def _round(matrix: FloatArray, bits: int) -> FloatArray:
    mantissa, exponent = np.frexp(matrix)
    return np.ldexp(np.rint(np.ldexp(mantissa, bits)), exponent - bits)
