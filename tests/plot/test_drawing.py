"""The drawing: an SVG that stands in a page, with its words as words and its curves inside its axes."""

import re
from xml.etree import ElementTree

import matplotlib.pyplot
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from ultraquiet.plot import Figure, Line, Panel, draw_axes, draw_svg
from ultraquiet.plot.draw import STYLE, _laid_out, panel_on
from ultraquiet.plot.legend import MOST_ABOVE

SVG = "{http://www.w3.org/2000/svg}"


def panel(labels=("first", "second"), **options):
    x = np.linspace(1.0, 10.0, 50)
    lines = [Line.of(x, k + np.sin(x), label, shade=k) for k, label in enumerate(labels)]
    return Panel(lines, "a title <&>", "time (s)", "V", **options)


def drawn(*panels, columns=1):
    return draw_svg(Figure("name", "Title", "Caption.", panels, columns))


def axes(svg):
    return [g for g in ElementTree.fromstring(svg).iter(f"{SVG}g") if re.fullmatch(r"axes_\d+", g.get("id", ""))]


def points(path):
    """Corners of a path: all numbers after its commands, as x and y."""
    return np.array(re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", path), dtype=float).reshape(-1, 2)


def words(svg):
    return ["".join(t.itertext()).strip() for t in ElementTree.fromstring(svg).iter(f"{SVG}text")]


def test_words_are_text_and_panels_are_axes():
    svg = drawn(panel(), panel(("third",)), panel(()), columns=2)
    assert len(axes(svg)) == 3
    said = words(svg)
    for word in ("a title <&>", "time (s)", "V", "first", "second", "third"):
        assert word in said
    assert said.count("a title <&>") == 3


@pytest.mark.parametrize("log", [False, True])
def test_curves_lie_inside_their_axes(log):
    svg = drawn(panel(x_log=log), panel(("alone",), x_log=log))
    for group in axes(svg):
        frame = points(next(group.iter(f"{SVG}path")).get("d"))
        curves = [p for p in group.iter(f"{SVG}path") if p.get("clip-path")]
        assert curves
        for path in curves:
            assert (points(path.get("d")) >= frame.min(axis=0) - 0.01).all()
            assert (points(path.get("d")) <= frame.max(axis=0) + 0.01).all()


def test_a_fixed_range_is_kept():
    wide = {t for t in words(drawn(panel(y_range=(-100.0, 100.0)))) if re.fullmatch(r"[−-]?\d+", t)}
    assert "100" in wide or "50" in wide
    assert not {"50", "100"} & set(words(drawn(panel())))


def test_ranges_of_equal_axes_are_the_least_that_is_shown(caplog):
    """A unit is as long up as across: one axis becomes wider, and nobody is told of it on a terminal."""
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(6.0, 3.0))
    on = canvas.subplots()
    panel_on(on, panel(x_range=(1.0, 10.0), y_range=(-2.0, 2.0), equal=True))
    FigureCanvasAgg(canvas).draw()
    across, up = on.get_xlim(), on.get_ylim()
    assert across[0] <= 1.0
    assert across[1] >= 10.0
    assert up[0] <= -2.0
    assert up[1] >= 2.0
    assert (across[1] - across[0], up[1] - up[0]) != (9.0, 4.0)
    assert not caplog.records


def test_many_names_stand_beside_the_curves():
    """A legend that would hide the lines is moved out of the axes, and the axes give way."""
    few, many = (axes(drawn(panel([f"curve {k}" for k in range(n)])))[0] for n in (MOST_ABOVE, MOST_ABOVE + 1))
    right_few, right_many = (points(next(g.iter(f"{SVG}path")).get("d"))[:, 0].max() for g in (few, many))
    assert right_many < right_few - 20


def test_the_same_figure_is_the_same_picture():
    """Without a date or random names, so that a report is compared by its bytes."""
    assert drawn(panel(), panel(())) == drawn(panel(), panel(()))


def test_a_picture_asks_for_nothing_outside():
    svg = drawn(panel())
    asked = re.findall(r'(?:href|src)="(?!#)([^"]*)"|url\((?!#)', svg)
    assert not asked
    assert "<script" not in svg
    assert svg.startswith("<svg")
    assert svg.rstrip().endswith("</svg>")


def test_gaps_in_the_data_are_gaps_in_the_curve():
    y = np.ones(50)
    y[20:30] = np.nan
    svg = drawn(Panel([Line(np.arange(50.0), y)], "", "time (s)", "V"))
    (curve,) = [
        p.get("d")
        for g in axes(svg)
        for p in g.iter(f"{SVG}path")
        if p.get("clip-path") and p.get("style") and "#0072b2" in p.get("style").lower()
    ]
    assert curve.count("M") == 2


@pytest.mark.parametrize("ways", [1, 2, 3])
def test_a_legend_covers_no_curve(ways):
    """Names that look the same in every panel stand above them all, as many rows as they need."""
    figure = drawn(panel([f"a rather long name {k}" for k in range(5)]), panel(("first",)), panel(()), columns=ways)
    curves = [points(p.get("d"))[:, 1] for g in axes(figure) for p in g.iter(f"{SVG}path") if p.get("clip-path")]
    named = [g for g in ElementTree.fromstring(figure).iter(f"{SVG}g") if g.get("id", "").startswith("legend")]
    assert len(named) == 1
    texts = list(named[0].iter(f"{SVG}text"))
    assert len(texts) == 6
    lowest = max(float(re.search(r"[, ]([\d.]+)\)", t.get("transform") or t.get("style"))[1]) for t in texts)
    assert lowest < min(y.min() for y in curves)


def words_drawn(figure):
    """Boxes in pixels of the titles, labels and names of a figure as it is drawn, by what they say."""
    with matplotlib.rc_context(STYLE):
        canvas = FigureCanvasAgg(_laid_out(figure, 100.0))
        canvas.draw()
        labels = [t for a in canvas.figure.axes for t in (a.title, a._left_title, a.xaxis.label, a.yaxis.label)]
        named = [t for each in (*canvas.figure.legends, *(a.get_legend() for a in canvas.figure.axes)) if each
                 for t in each.get_texts()]  # fmt: skip
        boxes = [(t.get_text(), t.get_window_extent()) for t in (*labels, *named) if t.get_text() and t.get_visible()]
    return boxes, canvas.figure.bbox


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_a_title_stands_on_no_name(columns):
    """What `.plot()` draws: title, names and panels' titles, none over another."""
    names = [f"a rather long name {k}" for k in range(5)]
    panels = [Panel([Line.of([0, 1], [k, k + 1], name) for name in names], f"panel {k}", "s", "V") for k in range(6)]
    drawn_axes = draw_axes(Figure("f", "The title of them all", "c", panels, columns, (8.0, 6.0)))
    figure = drawn_axes[0].figure
    figure.canvas.draw()
    (above,) = figure.legends
    words = [above.get_title(), *above.get_texts(), *(each._left_title for each in drawn_axes)]
    words += [] if figure._suptitle is None else [figure._suptitle]
    assert "The title of them all" in [text.get_text() for text in words]
    boxes = [text.get_window_extent() for text in words]
    assert not [a for k, a in enumerate(boxes) for b in boxes[:k] if a.overlaps(b)]
    matplotlib.pyplot.close(figure)


LONG = ("left front coil", "right front coil", "accelerometer rear")


@pytest.mark.gate("3-short", "6-long")
@pytest.mark.parametrize("names", [("strut 1", "strut 2", "strut 3"), LONG], ids=["short", "long"])
@pytest.mark.parametrize("many", [3, 6])
def test_words_of_many_panels_touch_nothing_and_are_not_cut(many, names):
    """A matrix of responses as a report prints it: every title in its place, one label where all say the same."""
    x = np.geomspace(1.0, 100.0, 20)
    panels = [
        Panel([Line.of(x, -x, "measured")], f"{names[k % 3]} → {names[k // many % 3]}", "frequency (Hz)", "gain (dB)")
        for k in range(many**2)
    ]
    boxes, sheet = words_drawn(Figure("name", "Title", "Caption.", panels, many, (7.2, 7.0)))
    assert len(boxes) > many**2
    for k, (text, box) in enumerate(boxes):
        assert sheet.x0 <= box.x0, text
        assert box.x1 <= sheet.x1 + 1.0, text
        for other, b in boxes[:k]:
            shared = min(box.x1, b.x1) - max(box.x0, b.x0), min(box.y1, b.y1) - max(box.y0, b.y0)
            assert min(shared) < 1.0, (text, other)


def test_several_curves_of_one_name_are_named_once():
    """The directions of a matrix are curves of one model: its name stands once, and leaves the panel its width."""
    x = np.linspace(1.0, 10.0, 50)
    lines = [Line.of(x, x + k, "plant" if k < 8 else "paper", shade=int(k >= 8)) for k in range(12)]
    other = Panel([Line.of(x, x, "plant", "--")])  # another look, so that each panel has a legend of its own
    said = words(drawn(Panel(lines)))
    assert (said.count("plant"), said.count("paper")) == (1, 1)
    assert words(drawn(Panel(lines), other)).count("plant") == 2
