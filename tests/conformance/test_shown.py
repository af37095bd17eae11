"""Every exported object shows itself: on one line, as a card, as a picture."""

import re
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from every_object import every_object, exported

import ultraquiet as uq
from ultraquiet import values
from ultraquiet._base.shown import show

MOST = 200
NAMES = sorted(exported())


@pytest.fixture(scope="module")
def objects(tmp_path_factory):
    made, bare = every_object(tmp_path_factory.mktemp("shown"))
    print(f"{len(made)} exported classes; fabricated, not computed: {', '.join(bare)}")
    return made


@pytest.mark.parametrize("name", NAMES)
def test_an_object_says_what_it_is_on_one_line(objects, name):
    said = repr(objects[name])
    assert len(said) < MOST, said
    assert "\n" not in said
    assert type(objects[name]).__name__ in said
    status = getattr(objects[name], "status", None)
    if hasattr(status, "word"):
        assert status.word in said


@pytest.mark.parametrize("name", NAMES)
def test_an_object_is_a_card(objects, name):
    page = objects[name]._repr_html_()
    assert type(objects[name]).__name__ in page
    assert not re.search(r"<script|src=|href=|https?://(?!www\.w3\.org/2000/svg)", page)
    for wire in [*getattr(objects[name], "sensors", ())][:3]:
        if isinstance(wire, uq.Channel):
            assert wire.name in page
            assert wire.unit in page


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_object_has_a_figure(objects, name):
    figure = uq.plot.figure(objects[name])
    assert figure.panels
    for panel in figure.panels:
        assert panel.words or (panel.lines and panel.x_label), f"{name}: a panel without curves or an axis without name"
        for line in panel.lines:
            assert np.shape(line.x) == np.shape(line.y), f"{name}: {panel.title}"


@pytest.mark.parametrize(
    "name", ["ultraquiet.Record", "StateSpace", "FrequencyResponse", "identify.Result", "design.DesignResult"]
)
def test_a_card_has_a_sparkline_where_there_is_a_curve(objects, name):
    key = name.replace("ultraquiet.", "values.") if "." in name else f"values.{name}"
    page = objects[key]._repr_html_()
    assert page.count("<svg") == 1
    assert "<polyline" in page


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_object_is_plotted_on_axes_with_names_and_units(objects, name):
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot
    from matplotlib.axes import Axes

    drawn = np.ravel(np.asarray(objects[name].plot(), dtype=object))
    try:
        assert all(isinstance(axes, Axes) for axes in drawn)
        for axes in drawn:
            assert axes.get_xlabel() or not axes.axison, f"{name}: an axis without a name"
        drawn[0].figure.canvas.draw()
    finally:
        pyplot.close(drawn[0].figure)


def test_a_figure_is_drawn_on_the_axes_that_are_given(objects):
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    canvas, axes = pyplot.subplots()
    try:
        assert objects["limits.Limit"].plot(axes) is axes
        assert axes.get_ylabel() == "dB"
        with pytest.raises(uq.errors.InputError, match="1 axes were given for the 4 panels"):
            objects["values.Record"].plot(axes)
    finally:
        pyplot.close(canvas)


def test_a_model_is_drawn_with_its_confidence(objects):
    panel = uq.plot.figure(objects["identify.Result"]).panels[0]
    (fill,) = panel.fills
    assert "confidence" in fill.label
    assert (fill.low <= panel.lines[0].y + 1e-9).all()
    assert (fill.high >= panel.lines[0].y - 1e-9).all()
    assert "m/s" in panel.y_label


def test_looking_loads_no_matplotlib():
    script = (
        "import sys, ultraquiet as uq; r = uq.Record([[1.0, 0.0]], [[0.1, 0.3]], 10.0); repr(r); r._repr_html_();"
        "print([m for m in sys.modules if m.startswith('matplotlib') or m == 'ultraquiet.plot'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_what_is_exported_later_is_shown_without_further_ado():
    @dataclass(frozen=True, eq=False)
    class Newcomer:
        values: np.ndarray
        status: values.Status

    show({"Newcomer": Newcomer}, ["Newcomer"])
    one = Newcomer(np.linspace(0.0, 1.0, 20), values.Status("fragile", "It may break."))
    assert repr(one) == "<Newcomer fragile: values (20)>"
    assert "It may break." in one._repr_html_()
    assert uq.plot.figure(one).panels[0].title == "values"
