"""Units of sensors and actuators in which the gains of a response are of one size: no fit may hang on a unit."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.pole_residue import Block

# An entry larger than its scales say counts so many times one that is smaller: of the gains of a channel the large ones
# tell its unit, the small ones are couplings and rounding.
LARGE = 100.0
STEPS = 50  # of the search for scales, at most; it ends when no entry changes sides any more


class EvenUnits(NamedTuple):
    """Factors of the sensors `(ny,)` and of the actuators `(nu,)` that even the entries of a matrix."""

    rows: FloatArray
    columns: FloatArray

    @classmethod
    def of(cls, sizes: FloatArray) -> "EvenUnits":
        """Return factors that bring the larger entries of each row and column near one.

        They minimise a sum over the squared logarithms of rows * sizes * columns, a convex function of the factors'
        own: other units give other factors and the same products.

        Args:
            sizes: `(ny, nu)`; an entry that is not above zero, or not finite, tells nothing.
        """
        ny, nu = sizes.shape
        known = np.isfinite(sizes) & (sizes > 0)
        i, j = np.nonzero(known)
        entries = np.zeros((i.size, ny + nu))
        entries[np.arange(i.size), i] = entries[np.arange(i.size), ny + j] = 1.0
        wanted = -np.log(sizes[known])
        factors, large = np.zeros(ny + nu), np.ones(i.size, dtype=bool)
        for _ in range(STEPS):
            heavy = np.sqrt(np.where(large, LARGE, 1.0))
            factors = np.linalg.lstsq(heavy[:, None] * entries, heavy * wanted, rcond=None)[0]
            before, large = large, entries @ factors > wanted
            if np.array_equal(large, before):
                break
        return cls(np.exp(factors[:ny]), np.exp(factors[ny:]))

    @classmethod
    def of_gains(cls, G: ComplexArray, variance: FloatArray, floor: float) -> "EvenUnits":
        """Return factors for gains `(ny, nu, nf)` with a variance.

        A channel that is noise, or the rounding of another one, is scaled by that: its noise is then what precision
        is not worth having, `floor`, and not a response to be met.
        """
        rounding = np.finfo(float).eps * np.abs(G).max(initial=0.0, where=np.isfinite(G))
        with np.errstate(divide="ignore", invalid="ignore"):
            each = np.log(np.abs(G) ** 2 + (variance + rounding**2) / floor**2) / 2
        told = np.isfinite(each)
        mean = np.sum(each, axis=2, where=told) / np.maximum(np.count_nonzero(told, axis=2), 1)
        return cls.of(np.where(np.any(G != 0, axis=2) & np.any(told, axis=2), np.exp(mean), 0.0))

    def evened(self, G: ComplexArray) -> ComplexArray:
        """Return gains `(ny, nu, ...)` in the even units."""
        return np.einsum("i,ij...,j->ij...", self.rows, G, self.columns)

    def undone(self, block: Block) -> Block:
        """Return a realisation of even units in those of before, its inputs and outputs alike in size."""
        A, B, C = block
        B, C = B / self.columns, C / self.rows[:, None]
        into, out = float(np.linalg.norm(B)), float(np.linalg.norm(C))
        share = np.sqrt(out / into) if into > 0 and out > 0 else 1.0
        return A, B * share, C / share
