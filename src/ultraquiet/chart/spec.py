"""What is drawn, as plain data: a grid of panels, a panel of curves, regions and marks over two axes.

`Packing` turns it into the JSON that `chart.js` draws; `Uq.grid(element, spec)` takes a whole grid and
`Uq.chart(element, spec)` one panel, both return an object whose `update(spec)` draws other data in the same place.
Keys of the JSON are the fields below, those that are None, False or empty left out; an array is either a list of
numbers or the name of one in `spec.data` or `Uq.data(...)`, base64 of little-endian float32:

    grid:   {name, title, caption, columns, share, enlarge, legend: "below" | "right" | "none", panels, data, tools}
    panel:  {title, x, y, curves, regions, marks, height, aspect, equal, tinted, detail: [panel, ...], map}
    axis:   {label, scale: "linear" | "log", range: [lo, hi], ticks: "dB" | "deg" | "int", names: [...]}
    curve:  {name, x, y, low, high, colour, dash: "-" | "--" | ":" | "-.", kind, symbol, width}
    map:    {name, x, y, z, range: [lo, hi]}
    region: {name, x: [lo, hi], y: [lo, hi], colour};   mark: {name, x | y, colour, dash}

`colour` is a word of `chart.css` ("measured", "open", "chosen", "law-1" ... "law-8", "ok", "fragile", "bad", "muted")
or "#rrggbb". Curves of one name are one entry of the legend, and switched together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from numpy.typing import ArrayLike

Range = tuple[float, float]
OpenRange = tuple[float | None, float | None]


@dataclass(frozen=True)
class Axis:
    """One axis: its label with the unit in brackets; without a range it fits what is drawn.

    `ticks` "dB" steps by 1, 3, 6, 10, 20, "deg" by 45, 90, 180, "int" by whole numbers; `names` stand at 0, 1, 2 ...
    in place of numbers.
    """

    label: str
    scale: Literal["linear", "log"] = "linear"
    range: Range | None = None
    ticks: Literal["dB", "deg", "int"] | None = None
    names: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve: `x`, `y` of one length, NaN where there is nothing; `low`, `high` bound its confidence.

    `kind` "line" and "step" are functions of an x that rises, with points where there is a `symbol`; "path" joins
    points in their order, "points" shows them with a `symbol` (".", "o", "x", "+", "s"), "bars" (of a `width` in x) and
    "stems" stand on zero.
    """

    name: str
    x: ArrayLike
    y: ArrayLike
    colour: str = "measured"
    dash: Literal["-", "--", ":", "-."] = "-"
    kind: Literal["line", "step", "path", "points", "bars", "stems"] = "line"
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    symbol: str = ""
    width: float = 0.0


@dataclass(frozen=True)
class Region:
    """A shaded band, such as what is required: over x, over y or both; an end that is None is the axis' own."""

    name: str
    x: OpenRange | None = None
    y: OpenRange | None = None
    colour: str = "requirement"


@dataclass(frozen=True)
class Mark:
    """A straight line at one x or one y, such as a limit."""

    name: str
    x: float | None = None
    y: float | None = None
    colour: str = "muted"
    dash: Literal["-", "--", ":", "-."] = "--"


@dataclass(frozen=True, eq=False)
class HeatMap:
    """Values over two axes as colours: `z` has one value for every `y` and, within it, every `x`, `(y, x)` flat or not.

    `x` and `y` rise and are the middles of the cells; `range` are the values of the darkest and the brightest colour.
    `name` says what is shown, its unit in brackets.
    """

    name: str
    x: ArrayLike
    y: ArrayLike
    z: ArrayLike
    range: Range


@dataclass(frozen=True, eq=False)
class ChartPanel:
    """Curves over two axes; `detail` are the panels shown below it when it is enlarged.

    `height` in CSS pixels, `aspect` width over height, at most so high; `equal`: one unit is as long up as across, what
    has more room shows more; `tinted` for the diagonal of a grid; `map` lies below the curves.
    """

    x: Axis
    y: Axis
    curves: Sequence[Curve]
    title: str = ""
    regions: Sequence[Region] = ()
    marks: Sequence[Mark] = ()
    height: int = 0
    aspect: float = 0.0
    equal: bool = False
    tinted: bool = False
    detail: Sequence["ChartPanel"] = ()
    map: HeatMap | None = None


@dataclass(frozen=True, eq=False)
class Chart:
    """One figure: panels in rows of `columns`, one legend, one zoom; `caption` says what to see.

    `name` is the stem of saved files. `share`: one y axis for all, labels at the outer edge alone; `enlarge`: a click
    shows a panel by itself with its detail.
    """

    name: str
    title: str
    caption: str
    panels: Sequence[ChartPanel]
    columns: int = 1
    share: bool = False
    enlarge: bool = False
    legend: Literal["below", "right", "none"] = "below"


@dataclass(frozen=True, eq=False)
class MovingShape:
    """How every point moves, as complex amplitudes `(n, 3)` in shares of the scene's size: x(t) = Re(shape e^(jwt))."""

    name: str
    re: ArrayLike
    im: ArrayLike


@dataclass(frozen=True, eq=False)
class Scene:
    """Points `(n, 3)` in space joined by lines (a, b), and shapes in which they move, each drawn by itself, moving."""

    name: str
    title: str
    caption: str
    points: ArrayLike
    lines: Sequence[tuple[int, int]]
    shapes: Sequence[MovingShape]


def frequency_axis(low_hz: float | None = None, high_hz: float | None = None, label: str = "frequency (Hz)") -> Axis:
    """Return a logarithmic axis in Hz, over a range where both ends are given.

    >>> frequency_axis(1, 1000).range
    (1, 1000)
    """
    return Axis(label, "log", None if low_hz is None or high_hz is None else (low_hz, high_hz))


def decibel_axis(what: str, relative_to: str = "", limits: Range | None = None) -> Axis:
    """Return an axis in decibels, relative to a unit where there is one.

    >>> decibel_axis("gain", "V/V").label
    'gain (dB re V/V)'
    """
    return Axis(f"{what} (dB re {relative_to})" if relative_to else f"{what} (dB)", "linear", limits, "dB")
