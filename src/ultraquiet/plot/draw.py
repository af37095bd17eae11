"""Draw figures with matplotlib."""

import io
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet.plot import legend
from ultraquiet.plot.figure import Figure, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas
    from matplotlib.typing import RcKeyType

# Okabe & Ito (2008), told apart by colour-blind readers as well.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
CHOSEN, ABOVE = 0, 2.5  # of the palette the chosen law's colour, and how high it lies: over all others, which lie at 2
# What was measured lies broad and below what is compared with it, so that it is seen where both are alike.
MEASURED, BELOW, BROAD_PT = 6, 1.9, 2.6
PNG_DPI, STILL_DPI = 150, 120
CROWDED = 12  # panels, beyond which each shows less
MOST_ROWS = 3  # of a name below an axis
LETTER_IN, ROW_IN = 0.075, 0.14  # of such a name
TITLE_PT, LEAST_PT = 9.0, 6.0  # of a title's letters
BARE_DECADES = 1.5  # of a logarithmic axis, from which on its small ticks bear no numbers
CONFIDENT = 0.15  # opacity of a confidence
# Inches beside each panel for numbers and title, for a label besides, right of all for a legend beside its panels.
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN, LABEL_IN, BESIDE_IN = 0.5, 0.15, 0.3, 0.3, 0.22, 1.9
STYLE: "dict[RcKeyType, Any]" = {
    "font.size": 8.5,
    "axes.titlesize": TITLE_PT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.fonttype": "none",
    "svg.hashsalt": "ultraquiet",
}


def draw_svg(figure: Figure) -> str:
    """Return a figure as one SVG element that can stand in a page."""
    text = _drawn(figure, "svg", {"Date": None, "Creator": None}).decode()
    return text[text.index("<svg") :]


def draw_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    return _drawn(figure, "png", {"Software": None})


def draw_small_png(figure: Figure, most_bytes: int) -> bytes:
    """Return a figure as a PNG of few colours and at most so many bytes: for lines no more are needed."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    with mpl.rc_context(STYLE):
        canvas = FigureCanvasAgg(_laid_out(figure, STILL_DPI))
        canvas.draw()
    flat = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    for share, colours in ((1.0, 64), (1.0, 16), (0.8, 16), (0.6, 12), (0.45, 8)):
        size = round(flat.width * share), round(flat.height * share)
        small = flat if share == 1 else flat.resize(size, Image.Resampling.LANCZOS)
        out = io.BytesIO()
        # the median cut of Pillow takes fifty times as long, and leaves more bytes
        small.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(out, "png")
        if out.tell() <= most_bytes:
            break
    return out.getvalue()


def _drawn(figure: Figure, form: str, metadata: dict[str, None]) -> bytes:
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        out = io.BytesIO()
        _laid_out(figure, PNG_DPI).savefig(out, format=form, metadata=metadata, dpi="figure")
    return out.getvalue()


def _laid_out(figure: Figure, dpi: float) -> "Canvas":
    """Return a figure as matplotlib's; to be called, and drawn, within the style."""
    from matplotlib.figure import Figure as Canvas

    columns = figure.columns
    rows = -(-len(figure.panels) // columns)
    canvas = Canvas(figsize=figure.size_in, dpi=dpi)
    above = legend.is_above(figure)
    grid = canvas.subplots(rows, columns, squeeze=False, gridspec_kw=_margins(figure, rows))
    for k, axes in enumerate(grid.ravel()):
        if k < len(figure.panels):
            panel_on(axes, figure.panels[k], named=not above and not _is_crowded(figure))
            if _is_crowded(figure):
                _bared(axes, figure, k)
            _ticks_as_one(axes)
        else:
            axes.set_visible(False)
    if above:
        legend.put_above(canvas, list(grid.ravel()), figure)
    return canvas


def _ticks_as_one(axes: "Axes") -> None:
    """Draw the small ticks of each logarithmic axis as one row of marks, where they bear no numbers.

    As ticks each of them is five objects, and to make these took a third of the time of a figure.
    """
    from matplotlib import rcParams
    from matplotlib.lines import Line2D
    from matplotlib.markers import TICKDOWN, TICKLEFT, MarkerStyle
    from matplotlib.ticker import NullLocator

    across = TICKDOWN, rcParams["xtick.minor.size"], rcParams["xtick.minor.width"]
    along = TICKLEFT, rcParams["ytick.minor.size"], rcParams["ytick.minor.width"]
    for axis, where, (mark, size, width) in (
        (axes.xaxis, axes.get_xaxis_transform(), across),
        (axes.yaxis, axes.get_yaxis_transform(), along),
    ):
        low, high = sorted(axis.get_view_interval())
        if axis.get_scale() != "log" or high < low * 10**BARE_DECADES:
            continue
        ticks = axis.get_minorticklocs()
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        axis.set_minor_locator(NullLocator())
        x, y = (ticks, np.zeros(ticks.size))[:: 1 if axis is axes.xaxis else -1]
        marks = Line2D(x, y, linestyle="none", marker=MarkerStyle(mark), color="black")
        marks.set(markersize=size, markeredgewidth=width, transform=where, clip_on=False)
        axes.add_artist(marks)


def _is_crowded(figure: Figure) -> bool:
    return len(figure.panels) > CROWDED


def _is_labelled_alike(figure: Figure) -> bool:
    """Return whether the label of a row's first panel stands for the row."""
    return _is_crowded(figure) and len({panel.y_label for panel in figure.panels}) == 1


def _bared(axes: "Axes", figure: Figure, k: int) -> None:
    """Leave out of one of many panels what its neighbours say: ticks and their words are what takes time."""
    from matplotlib.ticker import MaxNLocator

    last_row = k >= len(figure.panels) - figure.columns
    axes.minorticks_off()
    axes.tick_params(labelbottom=last_row)
    if not last_row:
        axes.set_xlabel("")
    if k % figure.columns and _is_labelled_alike(figure):
        axes.set_ylabel("")
    _titled(axes, figure.panels[k].title, LEFT_IN - 1.5 * RIGHT_IN)  # above the numbers, whose room is its own
    if axes.get_yscale() == "linear":
        axes.yaxis.set_major_locator(MaxNLocator(4))


def _margins(figure: Figure, rows: int) -> dict[str, float]:
    """Return where panels stand, as shares of the figure.

    A layout that measures every label draws the figure three times; room for the widest label is known beforehand.
    """
    width, height = figure.size_in
    left = LEFT_IN + LABEL_IN * any(panel.y_label for panel in figure.panels)
    bottom = BOTTOM_IN + LABEL_IN * any(panel.x_label for panel in figure.panels) + _below_in(figure)
    beside = BESIDE_IN if legend.is_beside(figure) else 0.0
    apart = LEFT_IN if _is_labelled_alike(figure) else left
    each_width = (width - RIGHT_IN - beside - left + apart) / figure.columns - apart
    crowded = _is_crowded(figure)
    above = legend.height_above_in(figure)
    between = TOP_IN + (0.0 if crowded else bottom)  # of many panels the last row alone has words below
    each_height = (height - above - TOP_IN - bottom - (rows - 1) * between) / rows
    return {
        "left": left / width,
        "right": 1 - (RIGHT_IN + beside) / width,
        "wspace": apart / each_width,
        "bottom": bottom / height,
        "top": 1 - (TOP_IN + above) / height,
        "hspace": between / each_height,
    }


def names_below(names: Sequence[str], letters: float) -> tuple[list[str], bool]:
    r"""Return names below an axis, folded where each has room for so many letters only, and whether they stand upright.

    >>> names_below(["left force", "right force"], 12.0)
    (['left force', 'right force'], False)
    >>> names_below(["left force", "right force"], 6.0)
    (['left\nforce', 'right\nforce'], False)
    >>> names_below(["accelerometer"], 6.0)
    (['accelerometer'], True)
    """
    room = max(int(letters), 1)
    rows = [textwrap.wrap(name, room, break_long_words=False, break_on_hyphens=False) or [""] for name in names]
    if max((len(part) for row in rows for part in row), default=0) <= room and max(map(len, rows)) <= MOST_ROWS:
        return ["\n".join(row) for row in rows], False
    return list(names), True


def _letters(panel: Panel, across_in: float) -> float:
    """Return how many letters a name below a panel of a width in inches has room for."""
    low, high = panel.x_range or (-0.5, len(panel.x_names) - 0.5)
    return across_in / max(high - low, 1.0) / LETTER_IN - 1.0


def _below_in(figure: Figure) -> float:
    """Return the room in inches that names take below their axes, beyond one row of numbers."""
    most, across = 0.0, figure.size_in[0] / figure.columns - LEFT_IN - LABEL_IN - RIGHT_IN
    for panel in figure.panels:
        names, upright = names_below(panel.x_names, _letters(panel, across)) if panel.x_names else ([], False)
        lines = [name.split("\n") for name in names]
        size = LETTER_IN * max(map(len, names), default=1) if upright else ROW_IN * max(map(len, lines), default=1)
        most = max(most, size - ROW_IN)
    return most


def _named(axes: "Axes", panel: Panel) -> None:
    """Put names in place of numbers, folded or upright where they would touch."""
    canvas = axes.get_figure(root=True)
    assert canvas is not None
    across = axes.get_position().width * canvas.get_size_inches()[0]
    names, upright = names_below(panel.x_names, _letters(panel, across))
    axes.set_xticks(range(len(names)), names, rotation=90 if upright else 0)


def title_within(title: str, room_in: float) -> tuple[str, float]:
    r"""Return a title as it stands in a room of inches and the size of its letters: smaller, in two rows, cut at last.

    >>> title_within("strut 1", 1.5)
    ('strut 1', 9.0)
    >>> title_within("left coil → geophone", 1.1)
    ('left coil → geophone', 6.5)
    >>> title_within("right front coil → accelerometer", 1.1)
    ('right front coil →\naccelerometer', 6.5)
    >>> title_within("x" * 40, 0.8)
    ('xxxxxxxxxxxxxxx…', 6.0)
    """
    for rows, size in (*((1, size) for size in (TITLE_PT, 8.0, 7.0, 6.5)), (2, 6.5), (2, LEAST_PT)):
        folded = _folded(title, room_in, size)
        if len(folded) <= rows and max(map(len, folded), default=0) <= _letters_at(room_in, size):
            return "\n".join(folded), size
    letters = _letters_at(room_in, LEAST_PT)
    first, second, *more = [*_folded(title, room_in, LEAST_PT), ""]
    rows = first, f"{second}…" if more[1:] else second
    return "\n".join(_cut(row, letters) for row in rows if row), LEAST_PT


def _letters_at(room_in: float, size: float) -> int:
    """Return how many letters of a size have room."""
    return max(int(room_in * TITLE_PT / (size * LETTER_IN)), 2)


def _folded(title: str, room_in: float, size: float) -> list[str]:
    return textwrap.wrap(title, _letters_at(room_in, size), break_long_words=False, break_on_hyphens=False)


def _cut(row: str, letters: int) -> str:
    return row if len(row) <= letters else f"{row[: letters - 1]}…"


def _titled(axes: "Axes", title: str, before_in: float = 0.0) -> None:
    """Put a title above axes, beginning so many inches left of them, where it ends before its neighbour begins."""
    canvas = axes.get_figure(root=True)
    assert canvas is not None
    across = axes.get_position().width * canvas.get_size_inches()[0]
    text, size = title_within(title, before_in + across + RIGHT_IN)
    # Where it stands is said: sought, it is clear of what else is above the axes, for which all of that is measured.
    axes.set_title(text, loc="left", fontsize=size, linespacing=1.0, x=-before_in / across, y=1.0)


def _draw_lines(axes: "Axes", panel: Panel) -> None:
    for line in panel.lines:
        colour = PALETTE[line.shade % len(PALETTE)]
        above, width = (ABOVE if line.shade == CHOSEN else None), None
        if line.shade == MEASURED and line.style == "-" and any(other.shade != MEASURED for other in panel.lines):
            above, width = BELOW, BROAD_PT
        axes.plot(line.x, line.y, line.style, color=colour, label=line.label or None, zorder=above, linewidth=width)


def panel_on(axes: "Axes", panel: Panel, named: bool = True) -> None:
    """Draw one panel on matplotlib axes."""
    from matplotlib.ticker import LogFormatter, StrMethodFormatter

    if panel.words:
        axes.axis("off")
        said = axes.text(0.0, 1.0, "\n".join(panel.words), va="top", family="monospace", transform=axes.transAxes)
        said.set_in_layout(False)  # long words are cut by the figure's edge, they do not press the axes to nothing
    if panel.coloured is not None:
        c = panel.coloured
        axes.pcolormesh(c.x, c.y, c.values, vmin=c.ends[0], vmax=c.ends[1], cmap="viridis", shading="nearest")
    _draw_lines(axes, panel)
    for fill in panel.fills:
        colour = PALETTE[fill.shade % len(PALETTE)]
        axes.fill_between(
            fill.x, fill.low, fill.high, color=colour, alpha=CONFIDENT, linewidth=0, label=fill.label or None
        )
    for low, high in panel.spans:
        axes.axvspan(low, high, color="#f0e442", alpha=0.25, linewidth=0)
    if panel.x_log:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    if panel.y_log:
        axes.set_yscale("log")
    # where both axes have one scale a range is the least that is shown: one of the two becomes wider
    if panel.x_range:
        axes.set_xlim(*panel.x_range, auto=panel.equal)
    if panel.y_range:
        axes.set_ylim(*panel.y_range, auto=panel.equal)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if panel.x_names:
        _named(axes, panel)
    _titled(axes, panel.title)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if named:
        legend.put_inside(axes, panel)
