"""The chart as an element of a page."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from ultraquiet.chart.spec import Chart, Scene
from ultraquiet.workbench.web.frames import FrameStore, packed


class ChartElement(ui.element, component="static/chart.js"):
    """A figure that can be drawn again in its place; what is drawn goes to the page as one binary frame.

    Args:
        frames: where the page fetches it.
        mark: `data-testid` of the element.
        on_zoom: told `{lo, hi}` when the user has zoomed.
        on_point: told `{panel, x, y}` when the user has clicked a point.
    """

    def __init__(
        self,
        frames: FrameStore,
        mark: str,
        on_zoom: Callable[[dict[str, Any]], object] | None = None,
        on_point: Callable[[dict[str, Any]], object] | None = None,
    ) -> None:
        super().__init__()
        self._frames = frames
        self.props(f'data-testid="{mark}"').classes("uq-chart")
        if on_zoom is not None:
            self.on("zoom", lambda event: on_zoom(event.args))
        if on_point is not None:
            self.on("point", lambda event: on_point(event.args))

    def show(self, figure: Chart | Scene) -> None:
        """Draw a figure in place of what was drawn."""
        self._props["frame"] = self._frames.put(packed(figure))
        self.update()
