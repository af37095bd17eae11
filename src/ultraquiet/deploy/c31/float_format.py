"""Numbers as the TMS320C31 holds them: 8 bits of exponent, 24 of mantissa, both in two's complement."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError

EXPONENT_BITS, FRACTION_BITS = 8, 23
ZERO_EXPONENT = -128  # reserved for zero, whatever the mantissa
LARGEST_EXPONENT = 127
SIGN = 1 << FRACTION_BITS
FRACTION = SIGN - 1


def encode(values: ArrayLike) -> NDArray[np.uint32]:
    """Return the nearest words of the C31's 32-bit format, ties away from minus infinity as its RND rounds.

    (01.f) 2^e for a positive number, (10.f) 2^e = (f - 2) 2^e for a negative one; e = -128 is zero. Every normal
    IEEE single is exact in it.

    Args:
        values: real numbers of any shape.

    Raises:
        InputError: a number that is not finite or reaches 2^128.

    >>> [f"{word:08X}" for word in encode([0.0, 1.0, -1.0, 1.5, -0.75])]
    ['80000000', '00000000', 'FF800000', '00400000', 'FFC00000']
    """
    v = np.asarray(values, dtype=np.float64)
    if not np.all(np.isfinite(v)):
        raise InputError("deploy: a number that is not finite has no C31 format; check the controller.")
    e = exponent(v)
    with np.errstate(over="ignore"):
        v = np.ldexp(np.floor(np.ldexp(v, FRACTION_BITS - e) + 0.5), e - FRACTION_BITS)
    e = exponent(v)  # rounding may have carried into the next power of two
    if np.any(e > LARGEST_EXPONENT):
        raise InputError(f"deploy: {np.abs(v).max():.1e} is beyond the C31's numbers, which end at 3.4e38.")
    small = (v == 0) | (e <= ZERO_EXPONENT)
    mantissa = np.ldexp(np.where(small, 0.0, v), FRACTION_BITS - np.where(small, 0, e)).astype(np.int64)
    sign = np.where(mantissa < 0, SIGN, 0)
    word = ((e & (2**EXPONENT_BITS - 1)) << (FRACTION_BITS + 1)) | sign | (mantissa & FRACTION)
    zero = np.uint32((ZERO_EXPONENT & (2**EXPONENT_BITS - 1)) << (FRACTION_BITS + 1))
    return np.where(small, zero, word).astype(np.uint32)


def decode(words: ArrayLike) -> FloatArray:
    """Return the numbers that words of the C31's 32-bit format hold.

    >>> decode([0x80000000, 0x00000000, 0xFF800000, 0xFFC00000]).tolist()
    [0.0, 1.0, -1.0, -0.75]
    """
    word = np.asarray(words, dtype=np.int64)
    e = word >> (FRACTION_BITS + 1)
    e = np.where(e > LARGEST_EXPONENT, e - 2**EXPONENT_BITS, e)
    lead = np.where(word & SIGN, -2 * SIGN, SIGN)
    value = np.ldexp((lead + (word & FRACTION)).astype(np.float64), e - FRACTION_BITS)
    return np.where(e == ZERO_EXPONENT, 0.0, value)


def exponent(values: FloatArray) -> NDArray[np.int64]:
    """Return e of the C31's normal form; -2^k takes k - 1, since its mantissa is -2.

    >>> exponent(np.array([1.0, -1.0, 3.0, -3.0])).tolist()
    [0, -1, 1, 1]
    """
    fraction, power = np.frexp(values)
    return power.astype(np.int64) - 1 - (fraction == -0.5)
