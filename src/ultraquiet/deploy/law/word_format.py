"""How many bits the code keeps of each quantity, and where their point stands."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ultraquiet.deploy.law.law import Law

Quantity = Literal["coefficients", "states", "sums", "readings and commands"]
QUANTITIES: tuple[Quantity, ...] = ("coefficients", "states", "sums", "readings and commands")


@dataclass(frozen=True)
class WordFormat:
    """The words of one quantity of a law's code.

    Attributes:
        quantity: what is kept in them; sums are what the products of a step add up in.
        bits: of a word, its sign included.
        significant: bits of a floating-point number's fraction, the leading one that is not stored included; None in
            fixed point.
        fractional: fewest and most bits behind the point in fixed point, rows are scaled one by one; None otherwise.
    """

    quantity: Quantity
    bits: int
    significant: int | None = None
    fractional: tuple[int, int] | None = None

    def __str__(self) -> str:
        """Return it in words.

        >>> str(WordFormat("states", 32, 24)), str(WordFormat("coefficients", 16, fractional=(14, 17)))
        ('32 bits, 24 significant', '16 bits, 14 to 17 fractional')
        """
        if self.fractional is None:
            return f"{self.bits} bits, {self.significant} significant"
        fewest, most = self.fractional
        return f"{self.bits} bits, {fewest}{'' if fewest == most else f' to {most}'} fractional"


def float_formats(law: Law) -> tuple[WordFormat, ...]:
    """Return the formats of a law in floating point: one for all, the C code computes in the precision it stores."""
    kept = np.finfo(law.dtype)
    return tuple(WordFormat(quantity, kept.bits, kept.nmant + 1) for quantity in QUANTITIES)
