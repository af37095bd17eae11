"""Where the legend of a drawn figure stands: outside its axes, so that it covers no curve."""

from typing import TYPE_CHECKING, Any

from ultraquiet.plot.figure import Figure, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

MOST_ABOVE = 8  # names; more of them stand beside the panel, where it has room there
# Inches of a name's sample of line, of a letter, of a row of names, and between names and panels.
SAMPLE_IN, LETTER_IN, ROW_IN, GAP_IN = 0.55, 0.068, 0.18, 0.1


def names(figure: Figure) -> list[str]:
    """Return what a legend of all panels names, each once."""
    return list(dict.fromkeys(name for panel in figure.panels for name in names_of(panel)))


def names_of(panel: Panel) -> list[str]:
    """Return what a legend of one panel names, each once: several curves may be of one name."""
    return list(dict.fromkeys(each.label for each in (*panel.lines, *panel.fills) if each.label))


def is_beside(figure: Figure) -> bool:
    """Return whether each panel has its legend at its right: many names, and nothing that stands there."""
    return figure.columns == 1 and any(len(names_of(panel)) > MOST_ABOVE for panel in figure.panels)


def is_above(figure: Figure) -> bool:
    """Return whether one legend above stands for all panels: each name has one look throughout."""
    looks: dict[str, set[tuple[str, int]]] = {}
    for panel in figure.panels:
        for line in panel.lines:
            looks.setdefault(line.label, set()).add((line.style, line.shade))
        for fill in panel.fills:
            looks.setdefault(fill.label, set()).add(("fill", fill.shade))
    looks.pop("", None)
    return bool(looks) and not is_beside(figure) and all(len(look) == 1 for look in looks.values())


def columns_above(figure: Figure) -> int:
    """Return how many names fit side by side."""
    shown = names(figure)
    widest = SAMPLE_IN + LETTER_IN * max(map(len, shown), default=1)
    return max(1, min(len(shown), int(figure.size_in[0] / widest)))


def height_above_in(figure: Figure) -> float:
    """Return the room in inches that the legend above all panels takes; 0 where there is none."""
    return GAP_IN + ROW_IN * -(-len(names(figure)) // columns_above(figure)) if is_above(figure) else 0.0


def put_above(canvas: "Canvas", axes: "list[Axes]", figure: Figure, room_is_made: bool = True) -> None:
    """Put one legend for all panels above them.

    Where no room is made yet the canvas' own layout makes it, and the legend bears the figure's title: of both by
    themselves that layout puts one over the other.
    """
    named = {label: line for each in axes for label, line in _samples(each).items()}
    place: dict[str, Any] = {"loc": "upper center"} if room_is_made else {"loc": "outside upper center"}
    if not room_is_made:
        place |= {"title": figure.title, "title_fontsize": "large"}
    canvas.legend(list(named.values()), list(named), ncols=columns_above(figure), borderaxespad=0.3, **place)


def put_inside(axes: "Axes", panel: Panel) -> None:
    """Put the legend of one panel where it hides least, at the panel's right where names are many."""
    named = _samples(axes)
    many = len(names_of(panel)) > MOST_ABOVE
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if many else {"loc": "best"}
    if named:
        axes.legend(list(named.values()), list(named), **place)


def _samples(axes: "Axes") -> "dict[str, Any]":
    """Return what shows the look of each name."""
    lines, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, lines, strict=True))
