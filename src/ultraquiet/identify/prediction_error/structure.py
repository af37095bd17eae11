"""Which polynomials a model has, and how they stand in the kernels' table."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray

IntArray = np.ndarray[Any, np.dtype[np.int64]]
ROW_A, ROW_C, ROW_D, ROW_FIRST = 0, 1, 2, 3
# Stages of a point of a search, first to last: residual, the past taken out of it, gradient.
RESIDUAL, PAST, GRADIENT = 0, 1, 2


@dataclass(frozen=True)
class Structure:
    """Numbers of free coefficients of A, B, C, D and F (B and F alike for every input) and the delay in samples."""

    a: int
    b: int
    c: int
    d: int
    f: int
    delay: int

    def parameters(self, inputs: int) -> int:
        """Return the number of free coefficients with `inputs` inputs."""
        return self.a + self.c + self.d + inputs * (self.b + self.f)

    @property
    def longest(self) -> int:
        """Coefficients of the longest of A, B and F: samples of each input that its past is told by."""
        return max(self.a, self.b, self.f)

    @property
    def models_noise(self) -> bool:
        """Whether it has polynomials that colour its noise."""
        return bool(self.a or self.c or self.d)

    def smaller(self) -> "Structure":
        """Return the structure with one coefficient less in every polynomial it has."""
        a, b, c, d, f = (max(0, k - 1) for k in (self.a, self.b, self.c, self.d, self.f))
        return Structure(a, b, c, d, f, self.delay)


def free_rows(inputs: int, rows: Sequence[int]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return the mask of rows that a search may move."""
    mask = np.zeros(ROW_FIRST + 2 * inputs, dtype=np.bool_)
    mask[list(rows)] = True
    return mask


def b_rows(inputs: int) -> list[int]:
    """Return the rows of the numerators."""
    return list(range(ROW_FIRST, ROW_FIRST + 2 * inputs, 2))


def f_rows(inputs: int) -> list[int]:
    """Return the rows of the denominators."""
    return list(range(ROW_FIRST + 1, ROW_FIRST + 2 * inputs, 2))


def reduced(polynomial: FloatArray, order: int) -> FloatArray:
    """Return the first `order` + 1 coefficients of a table row."""
    return np.array(polynomial[: order + 1])
