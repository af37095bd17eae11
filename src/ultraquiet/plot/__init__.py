"""Room `plot`: figures as data, and their drawing.

May be changed here: what a figure shows (`evidence.py`, `spectra.py`, `loop.py`, `frame.py`, `study.py`, `objects`,
`pages`) and how it looks (`draw.py`). Nothing is computed here beyond what a picture needs.
"""

from ultraquiet._base.shown import show
from ultraquiet.plot.axes import draw_axes, figure
from ultraquiet.plot.draw import draw_png, draw_small_png, draw_svg
from ultraquiet.plot.figure import Figure, Fill, Line, Panel
from ultraquiet.plot.page import chart_of, figure_of

__all__ = [
    "Figure",
    "Fill",
    "Line",
    "Panel",
    "chart_of",
    "draw_axes",
    "draw_png",
    "draw_small_png",
    "draw_svg",
    "figure",
    "figure_of",
]

show(globals(), __all__)
