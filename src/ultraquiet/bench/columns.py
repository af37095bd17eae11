"""Matrices as the kernels of the sampled loop take them."""

import numpy as np

from ultraquiet._base.constraints import FloatArray

Indices = np.ndarray[tuple[int, ...], np.dtype[np.uint64]]
Spanned = tuple[FloatArray, Indices, Indices]


def turned(matrix: FloatArray) -> FloatArray:
    """Return the transpose, contiguous and writable as the kernels expect."""
    return np.array(matrix.T, order="C")


def spanned(matrix: FloatArray) -> Spanned:
    """Return the columns of a matrix one after another, with the first and past the last entry of each that counts.

    >>> columns, first, end = spanned(np.array([[0.0, 1.0], [2.0, 0.0]]))
    >>> first.tolist(), end.tolist()
    ([1, 0], [2, 1])
    """
    columns = turned(matrix)
    rows = columns.shape[1]
    counts = columns != 0.0
    some = counts.any(axis=1)
    first = np.where(some, counts.argmax(axis=1) if rows else 0, 0)
    end = np.where(some, rows - counts[:, ::-1].argmax(axis=1) if rows else 0, 0)
    return columns, first.astype(np.uint64), end.astype(np.uint64)
