"""Schur forms with eigenvalues in a wanted order, and the loose array type that kernels use."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from scipy.linalg import LinAlgError, schur
from scipy.linalg.lapack import dgees, dtrsen  # pyright: ignore[reportAttributeAccessIssue]

# NumPy's stubs widen the result of most operations; kernels are typed by shape and name instead.
Array = Any
Matrices = tuple[Array, Array, Array, Array]  # A, B, C, D


def real_schur(A: Array) -> tuple[Array, Array]:
    """Return T and orthogonal Q with A = Q T Q', T quasi-triangular.

    Raises:
        LinAlgError: it was not found.
        ValueError: NaN or infinite entries.
    """
    return real_schur_values(A)[:2]


def real_schur_values(A: Array) -> tuple[Array, Array, Array]:
    """Return what `real_schur` does, and the eigenvalues in the order of T's diagonal."""
    T, Q, real, imaginary = _real_schur(A)
    return T, Q, real + 1j * imaginary


def complex_schur(A: Array) -> tuple[Array, Array]:
    """Return T and unitary Q with A = Q T Q^H, T triangular."""
    T, Q = schur(A, output="complex")[:2]
    return np.asarray(T), np.asarray(Q)


def ordered_schur(A: Array, wanted: Literal["lhp"] | Callable[[float, float], bool]) -> tuple[Array, Array, int]:
    """Return T, Q and how many eigenvalues are wanted; those come first.

    `wanted` is `lhp` (negative real part) or a function of real and imaginary part. What LAPACK's driver does with a
    call for each eigenvalue: one form, and another order only where it needs it.

    Raises:
        LinAlgError: an eigenvalue crossed the border while they were put in order.
        ValueError: NaN or infinite entries.
    """
    T, Q, real, imaginary = _real_schur(A)
    chosen = _wanted(real, imaginary, wanted)
    count = int(np.count_nonzero(chosen))
    if count and not np.all(chosen[:count]):
        T, Q, real, imaginary, count, _, _, info = dtrsen(chosen.astype(np.int32), T, Q, job="N")
        if info or not np.array_equal(_wanted(real, imaginary, wanted), np.arange(len(A)) < count):
            raise LinAlgError("an eigenvalue crossed the border while they were put in order")
    return T, Q, int(count)


def _real_schur(A: Array) -> tuple[Array, Array, Array, Array]:
    """Return T, Q and the eigenvalues' real and imaginary parts."""
    if not np.all(np.isfinite(A)):
        raise ValueError("array must not contain infs or NaNs")
    T, _, real, imaginary, Q, _, info = dgees(_unsorted, A, lwork=_schur_workspace(len(A)))
    if info:
        raise LinAlgError("the Schur form was not found")
    return T, Q, real, imaginary


def _unsorted(real: float, imaginary: float) -> None:
    """Stand in for the choice of eigenvalues that LAPACK's driver is not asked to make."""


@lru_cache(maxsize=256)
def _schur_workspace(n: int) -> int:
    return int(dgees(_unsorted, np.zeros((n, n)), lwork=-1)[-2][0])


def _wanted(real: Array, imaginary: Array, wanted: Literal["lhp"] | Callable[[float, float], bool]) -> Array:
    if callable(wanted):
        return np.array([bool(wanted(x, y)) for x, y in zip(real, imaginary, strict=True)], dtype=bool)
    return real < 0


def leading_subspace(T: Array, Q: Array, chosen: Array) -> Array:
    """Return orthonormal columns that span the invariant subspace of the chosen eigenvalues along T's diagonal.

    Raises:
        LinAlgError: the eigenvalues are too close to be reordered.
    """
    _, moved, _, _, count, _, _, info = dtrsen(np.asarray(chosen, dtype=np.int32), T, Q, job="N")
    if info:
        raise LinAlgError("the eigenvalues are too close to be put in another order")
    return np.asarray(moved)[:, :count]
