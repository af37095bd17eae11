"""Matrices, and laws of machine code, as the kernels of the sampled loop take them."""

from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values.controller import MachineStep

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


def called(machine: MachineStep | None) -> tuple[Any, ...]:
    """Return a step of machine code as the kernel calls it; None is the address 0, which is not called."""
    if machine is None:
        nothing, nowhere = np.empty(0), np.empty(0, dtype=np.int64)
        return 0, 0, 0, 0, nothing, nothing, nowhere, nowhere
    at = machine.readings.ctypes.data, machine.commands.ctypes.data
    return machine.function, machine.state, *at, machine.readings, machine.commands, machine.reads, machine.drives
