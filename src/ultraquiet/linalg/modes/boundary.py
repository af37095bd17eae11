"""Poles that cannot be told from the stability boundary: nearer than the last digits of a matrix decide."""

import numpy as np
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dgebal  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Relative errors of the entries that round-off leaves: so much for each row of a sum.
ROUNDED = 2 * float(np.finfo(float).eps)
# A law that cancels a pole is the solution of equations, which have its zero to no more digits than these. A pole that
# such an error moves is in doubt where it stands by itself on the boundary; poles that lie together some way inside it
# are worse conditioned, and yet where they are computed to be.
SOLVED = 2000 * float(np.finfo(float).eps)
UPON = 1e-10  # of the fastest pole, or of the unit circle's radius
# Of several poles together rounding moves each by a root of its size: of two, an eighth decimal.
NEAR = 1e-4
POINTS = 12  # nearest poles, that are looked at
STEPS = 8  # of a power iteration, that tell in a tenth of the time what is far from the limit


def on_boundary(A: FloatArray, poles: ComplexArray, discrete: bool) -> ComplexArray:
    """Return the points of the stability boundary, Im >= 0, at which a matrix has a pole as far as its digits tell.

    z is an eigenvalue of A + E with |E| <= e |A|, entry by entry, only where e is at least one over the spectral radius
    of |(z I - A)^-1| |A|. That number does not depend on the units of inputs, outputs, states or time, and it knows how
    far rounding moves poles that are badly conditioned or several in one place.

    Args:
        A: of a system, `(n, n)`.
        poles: its eigenvalues.
        discrete: whether the boundary is the unit circle; else it is the imaginary axis.

    >>> on_boundary(np.array([[1.0, 0.0], [0.3, 0.5]]), np.array([1.0 + 0j, 0.5]), discrete=True)
    array([1.+0.j])

    Demmel 1992, The componentwise distance to the nearest singular matrix, doi:10.1137/0613003.
    """
    points, gaps = _beside(poles, discrete)
    if not points.size:
        return points
    even = np.asarray(dgebal(A, scale=1, permute=0)[0], dtype=np.float64)
    rounding = ROUNDED * len(A)
    limits = np.where(gaps <= UPON, max(SOLVED, rounding), rounding)
    found = [_within(even, z, limit) for z, limit in zip(points, limits, strict=True)]
    return points[np.array(found)]


def _beside(poles: ComplexArray, discrete: bool) -> tuple[ComplexArray, FloatArray]:
    """Return the points of the boundary beside which poles lie, and how far off the nearest of each is, in parts."""
    points, gaps = _on_circle(poles) if discrete else _on_axis(poles)
    upper = points.imag >= 0
    points, gaps = points[upper], gaps[upper]
    order = np.argsort(gaps, kind="stable")
    points, first = np.unique(points[order], return_index=True)
    gaps = gaps[order][first]
    nearest = np.argsort(gaps, kind="stable")[:POINTS]
    return np.asarray(points[nearest], dtype=np.complex128), gaps[nearest]


def _on_circle(poles: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    size = np.abs(poles)
    gaps = np.abs(size - 1)
    near = gaps <= NEAR
    return np.asarray(poles[near] / size[near], dtype=np.complex128), gaps[near]


def _on_axis(poles: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Return a point for each pole that rings, and zero for the slow ones as a group."""
    size = np.abs(poles)
    fastest = max(float(size.max(initial=0.0)), np.finfo(float).tiny)
    ringing = (np.abs(poles.real) <= NEAR * size) & (poles.imag != 0)
    slow = size <= NEAR * fastest
    points = np.concatenate([1j * poles.imag[ringing], np.zeros(int(slow.sum()))]).astype(np.complex128)
    return points, np.concatenate([np.abs(poles.real[ringing]), size[slow]]) / fastest


def _within(A: FloatArray, z: complex, limit: float) -> bool:
    """Return whether errors of the entries of A up to `limit` of their size may give it the eigenvalue z."""
    try:
        spread = np.abs(np.linalg.inv(z * np.eye(len(A)) - A)) @ np.abs(A)
    except LinAlgError:
        return True
    if not np.isfinite(spread).all():
        return True
    v = np.ones(len(A))
    for _ in range(STEPS):
        moved = spread @ v
        if (moved * limit < v).all():  # Collatz and Wielandt: the spectral radius is at most the largest quotient
            return False
        v = np.maximum(moved / moved.max(), np.finfo(float).tiny)
    return bool(np.abs(np.linalg.eigvals(spread)).max() * limit >= 1)
