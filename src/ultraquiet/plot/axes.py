"""A figure on matplotlib axes, of a new figure or of the caller's: what `.plot()` returns."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import figure_of
from ultraquiet.plot import legend
from ultraquiet.plot.draw import STYLE, panel_on
from ultraquiet.plot.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def figure(shown: Any) -> Figure:
    """Return the figure of any object of this package as data; `draw_svg` and `draw_png` make files of it.

    >>> import ultraquiet as uq
    >>> figure(uq.Record([[0.0, 1.0]], [[0.0, 0.5]], rate_hz=10.0)).panels[0].x_label
    'time (s)'
    """
    return shown if isinstance(shown, Figure) else figure_of(shown)


def draw_axes(shown: Figure, ax: Any = None) -> "Axes | np.ndarray[Any, Any]":
    """Draw a figure with matplotlib.

    Args:
        shown: the figure as data.
        ax: axes to draw on, as many as there are panels; a new figure when absent.

    Returns:
        The axes, an array of them where there are several panels.

    Raises:
        InputError: another number of axes than of panels.
    """
    import matplotlib as mpl
    from matplotlib import pyplot

    canvas = None
    with mpl.rc_context(STYLE):
        above = ax is None and legend.is_above(shown)
        if ax is None:
            rows = -(-len(shown.panels) // shown.columns)
            canvas, grid = pyplot.subplots(
                rows, shown.columns, squeeze=False, figsize=shown.size_in, layout="constrained"
            )
            if not above:
                canvas.suptitle(shown.title)
            axes = cast("list[Axes]", list(grid.ravel()))
        else:
            axes = cast("list[Axes]", list(np.atleast_1d(np.asarray(ax, dtype=object)).ravel()))
            if len(axes) != len(shown.panels):
                raise InputError(f"plot: {len(axes)} axes were given for the {len(shown.panels)} panels of the figure.")
        for each, panel in zip(axes, shown.panels, strict=False):
            panel_on(each, panel, named=not above)
        if canvas is not None and above:
            legend.put_above(canvas, axes[: len(shown.panels)], shown, room_is_made=False)
        for each in axes[len(shown.panels) :]:
            each.set_visible(False)
    return _given_back(axes[: len(shown.panels)])


def _given_back(axes: "Sequence[Axes]") -> "Axes | np.ndarray[Any, Any]":
    if len(axes) == 1:
        return axes[0]
    out = np.empty(len(axes), dtype=object)
    out[:] = axes
    return out
