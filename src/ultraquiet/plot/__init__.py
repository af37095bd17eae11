"""Room `plot`: figures as data, and their drawing.

May be changed here: what a figure shows (`paper.py`, `evidence.py`, `spectra.py`, `loop.py`, `frame.py`) and how it
looks (`draw.py`). Nothing is computed here beyond what a picture needs.
"""

from ultraquiet.plot.draw import draw_png, draw_small_png, draw_svg
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.plot.page import chart_of, figure_of

__all__ = ["Figure", "Line", "Panel", "chart_of", "draw_png", "draw_small_png", "draw_svg", "figure_of"]
