"""The C31's extended arithmetic on arrays of float64, which hold every product of two 24-bit mantissas exactly.

Products are cut to 32 bits of mantissa, the smaller operand of a sum loses what its alignment shifts out, RND goes to
the nearest of 24 bits and a tie upwards, a store cuts to 24 bits. TMS320C3x User's Guide, floating-point operation.
"""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.c31.float_format import FRACTION_BITS, ZERO_EXPONENT, exponent

REGISTER_BITS = 31  # behind the leading one of an extended register


def multiplied(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return MPYF3 of numbers with 24 bits of mantissa."""
    return cut(a * b, REGISTER_BITS)


def added(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return ADDF3 of registers."""
    ea, eb = _exponent(a), _exponent(b)
    unit = np.ldexp(1.0, np.maximum(ea, eb) - REGISTER_BITS)
    total = np.floor(a / unit) * unit + np.floor(b / unit) * unit
    total = np.where(ea - eb > REGISTER_BITS, a, np.where(eb - ea > REGISTER_BITS, b, total))
    return np.where(a == 0, b, np.where(b == 0, a, cut(total, REGISTER_BITS)))


def rounded(a: FloatArray) -> FloatArray:
    """Return RND of registers."""
    return np.where(a == 0, 0.0, cut(a + np.ldexp(1.0, _exponent(a) - FRACTION_BITS - 1), FRACTION_BITS))


def stored(a: FloatArray) -> FloatArray:
    """Return what STF leaves of registers."""
    return cut(a, FRACTION_BITS)


def summed(products: FloatArray) -> FloatArray:
    """Return the sum of every row, from left to right in one register."""
    total = products[:, 0]
    for k in range(1, products.shape[1]):
        total = added(products[:, k], total)
    return total


def cut(v: FloatArray, bits: int) -> FloatArray:
    """Return numbers with so many bits behind the leading one, the others cut off, which goes downwards."""
    unit = np.ldexp(1.0, _exponent(v) - bits)
    return np.where(v == 0, 0.0, np.floor(v / unit) * unit)


def _exponent(v: FloatArray) -> FloatArray:
    return np.where(v == 0, ZERO_EXPONENT, exponent(v))
