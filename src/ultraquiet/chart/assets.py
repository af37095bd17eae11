"""The component's own files, as texts that stand in a page: nothing is fetched from anywhere."""

from importlib.resources import files

ROOM = "ultraquiet.chart"


def script() -> str:
    """Return uPlot and the chart component, one JavaScript text that defines `Uq`."""
    return text("uplot/uPlot.iife.min.js") + "\n" + text("chart.js")


def style() -> str:
    """Return the style sheets of uPlot and of the component, with the colours of both themes."""
    return text("uplot/uPlot.min.css") + "\n" + text("chart.css")


def text(name: str) -> str:
    """Return one file of this room."""
    return files(ROOM).joinpath(name).read_text("utf-8")
