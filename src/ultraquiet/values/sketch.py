"""What a bench looks like, and how its points move with its readings: for pictures of its modes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError


@dataclass(frozen=True, eq=False)
class Sketch:
    """Points `(n, 3)` joined by `lines` (a, b); `moves` `(n, 3, ny)` is how each point moves for one unit of a reading.

    A bench that has one offers it by a method `sketch()`.

    Raises:
        InputError: arrays of other shapes, or a line to a point that is not there.
    """

    points: FloatArray
    lines: Sequence[tuple[int, int]]
    moves: FloatArray

    def __post_init__(self) -> None:
        points, moves = np.asarray(self.points, dtype=float), np.asarray(self.moves, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or moves.ndim != 3 or moves.shape[:2] != points.shape:
            raise InputError(
                f"Sketch: points must be (n, 3) and moves (n, 3, readings), got {points.shape} and {moves.shape}."
            )
        if any(not 0 <= end < len(points) for line in self.lines for end in line):
            raise InputError(
                f"Sketch: a line joins points that are not there; they are numbered 0 to {len(points) - 1}."
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "moves", moves)

    def plain(self) -> dict[str, Any]:
        """Return it as JSON's types; `Sketch(**plain)` is the same."""
        lines = [[int(a), int(b)] for a, b in self.lines]
        return {"points": self.points.tolist(), "lines": lines, "moves": self.moves.tolist()}


def sketch_of(bench: Any) -> Sketch | None:
    """Return what a bench looks like, where it says so."""
    offered = getattr(bench, "sketch", None)
    drawn: Any = offered() if callable(offered) else None
    return drawn if isinstance(drawn, Sketch) else None


def row_of(readings: int) -> Sketch:
    """Return the sketch of a bench whose shape nobody told: its readings side by side, each moving up and down.

    >>> row_of(3).points[:3, 0].tolist()
    [-1.0, 0.0, 1.0]
    """
    across = np.linspace(-1.0, 1.0, readings) if readings > 1 else np.zeros(1)
    flat = np.zeros(readings)
    feet, heads = np.column_stack([across, flat, flat - 0.5]), np.column_stack([across, flat, flat])
    moves = np.zeros((2 * readings, 3, readings))
    moves[readings + np.arange(readings), 2, np.arange(readings)] = 1.0
    posts = [(k, readings + k) for k in range(readings)]
    beams = [(side + k, side + k + 1) for side in (0, readings) for k in range(readings - 1)]
    return Sketch(np.vstack([feet, heads]), [*posts, *beams], moves)
