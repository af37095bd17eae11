"""A closed loop at some lines."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray


class LoopParts(NamedTuple):
    """G, K and S = (I - G K)^-1, `(lines, rows, columns)` each."""

    G: ComplexArray
    K: ComplexArray
    S: ComplexArray

    @staticmethod
    def of(G: ComplexArray, K: ComplexArray) -> "LoopParts":
        """Close the loop of a plant and a law."""
        return LoopParts(G, K, np.linalg.inv(np.eye(G.shape[1]) - G @ K).astype(np.complex128))

    @property
    def control(self) -> ComplexArray:
        """K S."""
        return self.K @ self.S

    @property
    def at_input(self) -> ComplexArray:
        """(I - K G)^-1."""
        return np.eye(self.K.shape[1]) + self.control @ self.G

    def half_off(self, end: str) -> ComplexArray:
        """Return S - I/2 at an end of the plant, `(I - G K)^-1` at its output and `(I - K G)^-1` at its input."""
        S = self.S if end == "output" else self.at_input
        return S - np.eye(S.shape[1]) / 2

    def at(self, lines: np.ndarray) -> "LoopParts":
        """Return some of the lines."""
        return LoopParts(*(part[lines] for part in self))
