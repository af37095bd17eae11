"""A figure as data: panels of lines with axes. Any drawing, on paper or in a browser, starts from this."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray

# No picture here is wider than this many points; longer lines keep the extremes of each bin.
MOST_POINTS = 900


@dataclass(frozen=True, eq=False)
class Line:
    """One curve. `style` is "-", "--", ":" or "-."; `shade` picks a colour of the palette."""

    x: FloatArray
    y: FloatArray
    label: str = ""
    style: str = "-"
    shade: int = 0

    @classmethod
    def of(cls, x: ArrayLike, y: ArrayLike, label: str = "", style: str = "-", shade: int = 0) -> "Line":
        """Make a line, thinned so that every extreme remains visible."""
        xs, ys = np.asarray(x, dtype=float).ravel(), np.asarray(y, dtype=float).ravel()
        return cls(*thin(xs, ys), label, style, shade)


@dataclass(frozen=True, eq=False)
class Fill:
    """What lies between two curves over one x: a confidence, in the colour of the line that it belongs to."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    label: str = ""
    shade: int = 0


@dataclass(frozen=True, eq=False)
class Coloured:
    """Values `(y, x)` over two axes as colours, from the first of `ends` to the second; `label` says what they are."""

    x: FloatArray
    y: FloatArray
    values: FloatArray
    ends: tuple[float, float]
    label: str = ""


@dataclass(frozen=True)
class Panel:
    """Lines that share axes. `x_log` for frequencies, `y_log` for levels; `spans` are shaded bands (low, high) of x.

    `x_names` stand at 0, 1, 2 ... in place of numbers, `words` are lines of text for a panel without curves; `equal`:
    one unit is as long up as across.
    """

    lines: Sequence[Line]
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    x_log: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    spans: Sequence[tuple[float, float]] = ()
    y_log: bool = False
    x_names: Sequence[str] = ()
    fills: Sequence["Fill"] = ()
    words: Sequence[str] = ()
    coloured: Coloured | None = None
    equal: bool = False


@dataclass(frozen=True)
class Figure:
    """Panels in rows of `columns`; `name` is a file stem, `caption` says what to see, `size_in` is width and height."""

    name: str
    title: str
    caption: str
    panels: Sequence[Panel]
    columns: int = 1
    size_in: tuple[float, float] = (8.0, 4.0)


def thin(x: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """Return at most `most` points that keep the smallest and largest value of every bin.

    >>> thin(np.arange(10.0), np.arange(10.0), most=4)[1].tolist()
    [0.0, 4.0, 5.0, 9.0]
    """
    if x.size <= most:
        return x, y
    edges = np.linspace(0, x.size, most // 2 + 1).astype(int)
    keep = [
        start + k
        for start, stop in pairwise(edges)
        for k in sorted({int(np.argmin(y[start:stop])), int(np.argmax(y[start:stop]))})
    ]
    return x[keep], y[keep]
