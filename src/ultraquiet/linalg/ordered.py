"""Schur forms with eigenvalues in a wanted order, and the loose array type that kernels use."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, schur
from scipy.linalg.lapack import dtrsen  # pyright: ignore[reportAttributeAccessIssue]

# NumPy's stubs widen the result of most operations; kernels are typed by shape and name instead.
Array = Any
Matrices = tuple[Array, Array, Array, Array]  # A, B, C, D


def real_schur(A: Array) -> tuple[Array, Array]:
    """Return T and orthogonal Q with A = Q T Q', T quasi-triangular."""
    T, Q = schur(A, output="real")[:2]
    return np.asarray(T), np.asarray(Q)


def complex_schur(A: Array) -> tuple[Array, Array]:
    """Return T and unitary Q with A = Q T Q^H, T triangular."""
    T, Q = schur(A, output="complex")[:2]
    return np.asarray(T), np.asarray(Q)


def ordered_schur(A: Array, wanted: str | Callable[[float, float], bool]) -> tuple[Array, Array, int]:
    """Return T, Q and how many eigenvalues are wanted; those come first.

    `wanted` is `lhp`, `iuc` or a function of real and imaginary part.
    """
    T, Q, count = schur(A, output="real", sort=wanted)  # pyright: ignore[reportAssignmentType, reportCallIssue, reportArgumentType]
    return np.asarray(T), np.asarray(Q), int(count)


def diagonal_eigenvalues(T: Array) -> Array:
    """Return the eigenvalues of a real Schur form in the order of its diagonal."""
    values = np.diag(T).astype(np.complex128)
    for k in np.flatnonzero(np.diag(T, -1)):
        values[k : k + 2] = np.linalg.eigvals(T[k : k + 2, k : k + 2])
    return values


def leading_subspace(T: Array, Q: Array, chosen: Array) -> Array:
    """Return orthonormal columns that span the invariant subspace of the chosen eigenvalues along T's diagonal.

    Raises:
        LinAlgError: the eigenvalues are too close to be reordered.
    """
    _, moved, _, _, count, _, _, info = dtrsen(np.asarray(chosen, dtype=np.int32), T, Q, job="N")
    if info:
        raise LinAlgError("the eigenvalues are too close to be put in another order")
    return np.asarray(moved)[:, :count]
