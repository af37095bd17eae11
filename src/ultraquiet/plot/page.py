"""Figures on paper and figures on a page: each made from the other, so that both show the same."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Region, Scene
from ultraquiet.plot import legend
from ultraquiet.plot.figure import Coloured, Figure, Line, Panel

# Colour words of the page in the order of the paper's palette; what has no place there is drawn black.
WORDS = ("chosen", "law-1", "law-2", "law-3", "law-4", "law-5", "measured", "open")
SHADES = {**{word: k for k, word in enumerate(WORDS)}, "ok": 2, "fragile": 4, "bad": 1, "muted": 7}
BLACK = 6
MARKS = {".": ".", "o": "o", "x": "x", "+": "+", "s": "s"}
PIXELS_PER_IN = 110.0
STILL_IN = 8.0  # width of a still
STILL_PANEL_IN = 1.9
NAMES_IN = 0.4  # names below an axis
SWING, TURN, TILT = 0.22, 0.6, 0.35  # of a shape: its size over the scene's, and from where it is seen
DASHES: dict[str, Literal["-", "--", ":", "-."]] = {"-": "-", "--": "--", ":": ":", "-.": "-."}


def chart_of(figure: Figure) -> Chart:
    """Return a figure on paper as the page draws it."""
    panels = [_panel(panel, figure) for panel in figure.panels]
    return Chart(figure.name, figure.title, figure.caption, panels, figure.columns)


def _panel(panel: Panel, figure: Figure) -> ChartPanel:
    x = Axis(panel.x_label, "log" if panel.x_log else "linear", panel.x_range)
    ticks = "dB" if "dB" in panel.y_label else "deg" if panel.y_label in ("degrees", "phase (°)") else None
    y = Axis(panel.y_label, "log" if panel.y_log else "linear", panel.y_range, ticks)
    regions = [Region("band", span) for span in panel.spans]
    rows = -(-len(figure.panels) // figure.columns)
    height = int(PIXELS_PER_IN * figure.size_in[1] / rows)
    filled = [Curve(f.label, f.x, f.low, WORDS[f.shade % len(WORDS)], low=f.low, high=f.high) for f in panel.fills]
    return ChartPanel(x, y, [*filled, *(_curve(line) for line in panel.lines)], panel.title, regions, height=height)


def _curve(line: Line) -> Curve:
    rises = bool(np.all(np.diff(line.x) >= 0))
    kind = "line" if rises else "path"
    return Curve(line.label, line.x, line.y, WORDS[line.shade % len(WORDS)], DASHES.get(line.style, "-"), kind)


def figure_of(chart: Chart) -> Figure:
    """Return what the page draws as a figure on paper."""
    panels = [_still(panel) for panel in chart.panels]
    columns = min(chart.columns, max(len(panels), 1))
    rows = -(-len(panels) // columns)
    tall = max((p.height for p in chart.panels), default=0) / PIXELS_PER_IN
    each = STILL_IN / columns * 0.75 if any(p.aspect for p in chart.panels) else max(STILL_PANEL_IN, 0.9 * tall)
    size = (STILL_IN, min(each * rows if columns < 4 else 1.3 * rows, 11.0))
    figure = Figure(chart.name, chart.title, chart.caption, panels, columns, size)
    if rows == 1 and any(panel.x_names for panel in panels):  # what stands above and below takes nothing from the bars
        return replace(figure, size_in=(STILL_IN, size[1] + legend.height_above_in(figure) + NAMES_IN))
    return figure


def still_of(scene: Scene) -> Figure:
    """Return a scene as a figure on paper: every shape at its largest, over the points at rest."""
    points = np.asarray(scene.points, dtype=float).reshape(-1, 3)
    points = points - points.mean(axis=0)
    reach = max(float(np.linalg.norm(points, axis=1).max()), np.finfo(float).tiny)
    panels = []
    for shape in scene.shapes:
        moved = points + SWING * reach * np.asarray(shape.re, dtype=float).reshape(-1, 3)
        lines = [Line(*_seen(points, scene.lines), "at rest", "--", SHADES["open"])]
        lines.append(Line(*_seen(moved, scene.lines), "moved", "-", SHADES["chosen"]))
        wide = 1.4 * reach
        panels.append(Panel(lines, shape.name, x_range=(-wide, wide), y_range=(-wide, wide)))
    columns = min(3, len(panels))
    return Figure(scene.name, scene.title, scene.caption, panels, columns, (STILL_IN, 2.6 * -(-len(panels) // columns)))


def _seen(points: FloatArray, lines: Sequence[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
    """Return lines in space as one broken line on paper, seen from aside and a little above."""
    c, s, ct, st = np.cos(TURN), np.sin(TURN), np.cos(TILT), np.sin(TILT)
    x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    flat = np.vstack([np.column_stack([x, ct * points[:, 2] + st * y]), [np.nan, np.nan]])
    order = [end for a, b in lines for end in (a, b, len(points))]
    return flat[order, 0], flat[order, 1]


def _still(panel: ChartPanel) -> Panel:
    lines = [line for curve in panel.curves for line in _lines(curve)]
    ends = panel.x.range or _ends(panel.curves)
    for mark in panel.marks:
        shade = SHADES.get(mark.colour, BLACK)
        if mark.y is not None and ends is not None:
            lines.append(Line(np.array(ends), np.full(2, mark.y), mark.name, "--", shade))
    spans = [(low, high) for r in panel.regions if r.x for low, high in [r.x] if low is not None and high is not None]
    logs = panel.x.scale == "log", panel.y.scale == "log"
    x_range = ends if logs[0] else panel.x.range
    names = (panel.title, panel.x.label, panel.y.label)
    still = Panel(lines, *names, logs[0], x_range, panel.y.range, spans, logs[1], panel.x.names, equal=panel.equal)
    if panel.map is None:
        return still
    x, y = (np.asarray(part, dtype=float).ravel() for part in (panel.map.x, panel.map.y))
    z = np.asarray(panel.map.z, dtype=float).reshape(y.size, x.size)
    return replace(still, coloured=Coloured(x, y, z, panel.map.range, panel.map.name))


def _ends(curves: Sequence[Curve]) -> tuple[float, float] | None:
    values = [np.ravel(c.x) for c in curves if np.size(c.x)]
    return (min(float(v.min()) for v in values), max(float(v.max()) for v in values)) if values else None


def _lines(curve: Curve) -> list[Line]:
    x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
    shade = SHADES.get(curve.colour, BLACK)
    if curve.kind in ("bars", "stems"):
        return [Line(*outlines(x, y, curve.width), curve.name, "-", shade)]
    if curve.kind == "points":
        return [Line(x, y, curve.name, MARKS.get(curve.symbol, "."), shade)]
    if curve.kind == "path":
        return [Line(x, y, curve.name, curve.dash, shade)]
    sides = [Line.of(x, side, style=":", shade=shade) for side in (curve.low, curve.high) if side is not None]
    return [*sides, Line.of(x, y, curve.name, curve.dash, shade)]


def outlines(x: FloatArray, y: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Return the outlines of bars on zero as one broken line."""
    half = np.array([-0.5, -0.5, 0.5, 0.5, np.nan])
    across = (x[:, None] + width * half).ravel()
    up = (y[:, None] * np.array([0.0, 1.0, 1.0, 0.0, np.nan])).ravel()
    return across, up
