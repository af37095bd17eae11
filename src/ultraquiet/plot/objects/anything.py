"""What has no figure of its own: its long arrays as curves, else its numbers and settings as they read."""

from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown import draws, figure_of
from ultraquiet._base.shown.line import attributes, line, text, word
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, PolynomialModel, StateSpace

HOLDERS = ("model", "controller", "system", "response")
MODELS = (FrequencyResponse, PolynomialMatrix, PolynomialModel, StateSpace)
AXES = {"f_hz": "frequency (Hz)", "time_s": "time (s)", "tones_hz": "tone (Hz)"}
# The last part of a name says its unit.
UNITS = {
    "db": "dB", "hz": "Hz", "s": "s", "v": "V", "deg": "degrees", "percent": "%", "rms": "rms", "p": "p-value",
    "us": "us", "c": "°C", "w": "W",
}  # fmt: skip
FEWEST, MOST_PANELS, MOST_ROWS, MOST_CURVES = 2, 6, 18, 8
DEEPEST = 2
PANEL_IN = (6.0, 2.2)


@draws(Figure)
def itself(figure: Figure) -> Figure:
    """A figure as it is."""
    return figure


@draws(object)
def any_figure(shown: Any) -> Figure:
    """The model or law that it holds; else arrays over the frequencies or times beside them, or over their index."""
    for name in HOLDERS:
        held = getattr(shown, name, None)
        if isinstance(held, MODELS):
            drawn = figure_of(held)
            return Figure(name, type(shown).__name__, line(shown), drawn.panels, drawn.columns, drawn.size_in)
    panels = [panel for panel, _ in zip(_curves(shown, DEEPEST), range(MOST_PANELS), strict=False)] or [_words(shown)]
    size = (PANEL_IN[0], max(PANEL_IN[1] * len(panels), 3.0))
    return Figure(type(shown).__name__.lower(), type(shown).__name__, line(shown), panels, 1, size)


def _curves(shown: Any, depth: int) -> Iterator[Panel]:
    held = dict(attributes(shown))
    over = {np.size(held[name]): name for name in AXES if name in held and np.ndim(held[name]) == 1}
    for name, value in held.items():
        if name in AXES or value is None:
            continue
        if isinstance(value, np.ndarray):
            numbers = cast("np.ndarray[Any, Any]", value)
            if numbers.ndim and numbers.shape[-1] >= FEWEST and numbers.dtype.kind in "fciub":
                yield _panel(name, numbers, over, held)
        elif depth and type(value).__module__.startswith("ultraquiet") and hasattr(value, "__dataclass_fields__"):
            yield from _curves(value, depth - 1)


def _panel(name: str, values: "np.ndarray[Any, Any]", over: dict[int, str], held: dict[str, Any]) -> Panel:
    n = values.shape[-1]
    axis = over.get(n, "")
    x = np.asarray(held[axis], dtype=float) if axis else np.arange(n, dtype=float)
    rows = _real(values).reshape(-1, n)
    wires = held.get("sensors") or held.get("channels") or ()
    labels = [getattr(c, "name", "") for c in wires] if len(wires) == len(rows) else [""] * len(rows)
    if not any(labels) and len(rows) > 1:
        labels = [f"{name}[{', '.join(map(str, at))}]" for at in np.ndindex(values.shape[:-1])]
    lines = [Line.of(x, row, label, shade=k) for k, (row, label) in enumerate(zip(rows, labels, strict=True))]
    x_label = AXES.get(axis, "index")
    title, unit = titled(name)
    positive = bool((x > 0).all()) and axis in ("f_hz", "tones_hz") and n > MOST_CURVES
    unit = "dB" if np.iscomplexobj(values) else unit
    return Panel(lines[:MOST_CURVES], title, x_label, unit or title, x_log=positive)


def _real(values: "np.ndarray[Any, Any]") -> FloatArray:
    if np.iscomplexobj(values):
        return 20.0 * np.log10(np.maximum(np.abs(values), np.finfo(float).tiny))
    return np.asarray(values, dtype=np.float64)


def titled(name: str) -> tuple[str, str]:
    """Return a name as a title and the unit that it carries.

    >>> titled("reduction_db"), titled("loss")
    (('reduction', 'dB'), ('loss', ''))
    """
    stem, _, tail = name.rpartition("_")
    if stem and tail in UNITS:
        return stem.replace("_", " "), UNITS[tail]
    return name.replace("_", " "), ""


def _words(shown: Any) -> Panel:
    """Return a panel of words alone: what the object is, and what it holds."""
    rows = [type(shown).__name__ + (f": {word(shown)}" if word(shown) else "")]
    rows += [f"{name} = {text(value)}" for name, value in attributes(shown)][:MOST_ROWS]
    return Panel([], "", words=rows)
