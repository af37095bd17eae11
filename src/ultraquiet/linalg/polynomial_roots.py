"""Monic real polynomials and their roots: from the one to the other, and back inside the unit circle."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

SMALLEST = 1e-300  # a root at the origin is divided by this, and stays there


def mirrored_inside(roots: ComplexArray, radius: float) -> ComplexArray:
    """Return the roots with those outside mirrored into the unit circle, and none beyond `radius`.

    >>> mirrored_inside(np.array([2.0, -0.999, 0.5j]), 0.9).tolist()
    [(0.5+0j), (-0.9+0j), 0.5j]
    """
    size = np.maximum(np.abs(roots), SMALLEST)
    inside = np.where(size > 1.0, 1.0 / size, size)
    return roots / size * np.minimum(inside, radius)


def monic_from_roots(roots: ComplexArray) -> FloatArray:
    """Return the monic real polynomial with these roots, highest power first.

    >>> monic_from_roots(np.array([0.5j, -0.5j])).tolist()
    [1.0, 0.0, 0.25]
    >>> monic_from_roots(np.zeros(0, dtype=complex)).tolist()
    [1.0]
    """
    return np.atleast_1d(np.real(np.poly(roots))).astype(np.float64)


def stabilised(polynomial: FloatArray, radius: float) -> FloatArray:
    """Return the monic polynomial with its roots mirrored inside: a model to begin from, never a step of a search.

    >>> stabilised(np.array([1.0, -2.0]), 0.9).tolist()
    [1.0, -0.5]
    """
    if polynomial.size < 2:
        return polynomial
    return monic_from_roots(mirrored_inside(np.roots(polynomial).astype(np.complex128), radius))
