"""Every exported object shows itself: on one line, as a card, as a picture."""

import re

import numpy as np
import pytest
from every_object import every_object, exported

import ultraquiet as uq

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


@pytest.mark.parametrize("name", NAMES)
def test_an_object_has_a_figure(objects, name):
    figure = uq.plot.figure(objects[name])
    assert figure.panels
    for panel in figure.panels:
        assert panel.words or (panel.lines and panel.x_label), f"{name}: a panel without curves or an axis without name"
        for line in panel.lines:
            assert np.shape(line.x) == np.shape(line.y), f"{name}: {panel.title}"
