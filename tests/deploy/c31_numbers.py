"""The C31's extended arithmetic on integers, bit by bit as its manual has it, for the interpreter.

It shares nothing with the package's twin of the frame, which counts in float64: the one judges the other.

A register's float is (e, m): 33 bits of mantissa in two's complement with its leading bit written out, 2^31 <= m < 2^32
or -2^32 <= m < -2^31; e = -128 is zero. TMS320C3x User's Guide, chapter on data formats and floating-point operation.
"""

import numpy as np

ONE, TWO = 1 << 31, 1 << 32
ZERO = (-128, ONE)
LOW = 0xFFFFFFFF


def multiply(a, b):
    """MPYF: both operands are cut to 24 bits of mantissa; the product's 32 bits are cut, not rounded."""
    if a[0] == -128 or b[0] == -128:
        return ZERO
    m = ((a[1] >> 8) * (b[1] >> 8)) >> 15
    return _normal(a[0] + b[0], m)


def add(a, b):
    """ADDF: the smaller operand loses the bits that alignment shifts out."""
    if a[0] == -128:
        return b
    if b[0] == -128:
        return a
    if a[0] < b[0]:
        a, b = b, a
    gap = a[0] - b[0]
    return a if gap >= 32 else _normal(a[0], a[1] + (b[1] >> gap))


def negative(a):
    return ZERO if a[0] == -128 else _normal(a[0], -a[1])


def rounded(a):
    """RND: to the nearest of 24 bits, a tie upwards."""
    return ZERO if a[0] == -128 else _normal(a[0], ((a[1] + 0x80) >> 8) << 8)


def _normal(e, m):
    if m == 0:
        return ZERO
    while m >= TWO or m < -TWO:
        m >>= 1
        e += 1
    while -ONE <= m < ONE:
        m <<= 1
        e -= 1
    if e <= -128:
        return ZERO
    if e > 127:
        return (127, TWO - 1) if m > 0 else (127, -TWO)
    return (e, m)


def low_bits(a):
    """Return the 32 bits of a register's mantissa, which are its integer."""
    return (a[1] - ONE if a[1] >= 0 else a[1] + TWO + ONE) & LOW


def from_bits(e, low):
    return (e, low + ONE if low < ONE else low - ONE - TWO)


def to_word(a):
    """STF: exponent and the upper 24 bits, cut."""
    return ((a[0] & 0xFF) << 24) | (low_bits(a) >> 8)


def from_word(word):
    e = word >> 24
    return from_bits(e - 256 if e > 127 else e, (word & 0xFFFFFF) << 8)


def integer(a):
    low = low_bits(a)
    return low - TWO if low & ONE else low


def from_integer(value, e=0):
    return from_bits(e, value & LOW)


def floated(value):
    """FLOAT: exact, 32 bits fit the mantissa."""
    return _normal(31, value) if value else ZERO


def fixed(a):
    """FIX: downwards, held within 32 bits."""
    if a[0] == -128:
        return 0
    shift = 31 - a[0]
    whole = a[1] >> shift if shift >= 0 else a[1] << -shift
    return max(-ONE, min(ONE - 1, whole))


def value(a):
    return 0.0 if a[0] == -128 else float(np.ldexp(float(a[1]), a[0] - 31))
