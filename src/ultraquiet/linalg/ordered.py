"""Schur forms with eigenvalues in a wanted order, and the loose array type that kernels use."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import schur

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
