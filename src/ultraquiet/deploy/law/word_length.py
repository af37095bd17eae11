"""How many bits a controller's coefficients need, form by form, and what its code keeps of each quantity."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.law.form_choice import error_of
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.law.realisation import FORMS, Realisation, realisation
from ultraquiet.values.state_space import StateSpace

SIGNIFICANT = (8, 12, 16, 20, 24)  # 24: float32, and the TMS320C31's own format
Quantity = Literal["coefficients", "states", "sums", "readings and commands"]
QUANTITIES: tuple[Quantity, ...] = ("coefficients", "states", "sums", "readings and commands")


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


@dataclass(frozen=True)
class WordFormat(Shown):
    """The words of one quantity of a law's code.

    Attributes:
        quantity: what is kept in them; sums are what the products of a step add up in.
        bits: of a word, its sign included.
        significant: bits of a floating-point number's fraction, the leading one that is not stored included; None in
            fixed point.
        fractional: fewest and most bits behind the point in fixed point, rows are scaled one by one; None otherwise.
    """

    quantity: Quantity
    bits: int
    significant: int | None = None
    fractional: tuple[int, int] | None = None

    def __str__(self) -> str:
        """Return it in words.

        >>> str(WordFormat("states", 32, 24)), str(WordFormat("coefficients", 16, fractional=(14, 17)))
        ('32 bits, 24 significant', '16 bits, 14 to 17 fractional')
        """
        if self.fractional is None:
            return f"{self.bits} bits, {self.significant} significant"
        fewest, most = self.fractional
        return f"{self.bits} bits, {fewest}{'' if fewest == most else f' to {most}'} fractional"


def float_formats(law: Law) -> tuple[WordFormat, ...]:
    """Return the formats of a law in floating point: one for all, the C code computes in the precision it stores."""
    kept = np.finfo(law.dtype)
    return tuple(WordFormat(quantity, kept.bits, kept.nmant + 1) for quantity in QUANTITIES)
