"""Room `chart`: what a page draws, as data, and the script that draws it; one component for report and workbench.

May be changed here: what a figure can be made of (`spec.py`), how it becomes JSON (`packing.py`), which colour means
what (`colours.py`), and how it is drawn (`chart.js`, `chart.css`, on the uPlot beside them). Nothing is computed here.
"""

from ultraquiet.chart.assets import script, style
from ultraquiet.chart.colours import law_colours
from ultraquiet.chart.packing import Packing
from ultraquiet.chart.spec import (
    Axis,
    Chart,
    ChartPanel,
    Curve,
    HeatMap,
    Mark,
    MovingShape,
    Region,
    Scene,
    decibel_axis,
    frequency_axis,
)

__all__ = [
    "Axis",
    "Chart",
    "ChartPanel",
    "Curve",
    "HeatMap",
    "Mark",
    "MovingShape",
    "Packing",
    "Region",
    "Scene",
    "decibel_axis",
    "frequency_axis",
    "law_colours",
    "script",
    "style",
]
