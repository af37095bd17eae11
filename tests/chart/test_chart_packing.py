"""What a figure becomes before a browser draws it."""

import base64
import json
import re

import numpy as np
import pytest

from ultraquiet import chart
from ultraquiet._base.errors import InputError


def figure(*curves):
    axis = chart.frequency_axis(1, 100)
    return chart.Chart("one", "One", "caption", [chart.ChartPanel(axis, chart.decibel_axis("gain", "V/N"), curves)])


def test_every_array_stands_once_and_comes_back_as_float32(rng):
    f, y = np.geomspace(1, 100, 50), rng.standard_normal(50)
    packing = chart.Packing()
    spec = packing.spec(figure(chart.Curve("a", f, y), chart.Curve("b", f, y, "chosen", low=y, high=y)))
    a, b = spec["panels"][0]["curves"]
    assert a["x"] == b["x"]
    assert a["y"] == b["y"] == b["low"] == b["high"]
    assert len(packing.data) == 2
    back = np.frombuffer(base64.b64decode(packing.data[a["y"]]), "<f4")
    np.testing.assert_array_equal(back, y.astype(np.float32))
    assert json.loads(json.dumps(packing.whole(figure()))) == packing.whole(figure())


def test_what_is_not_said_is_left_out():
    spec = chart.Packing().spec(figure(chart.Curve("a", [1.0], [2.0])))
    assert set(spec) == {"name", "title", "caption", "panels", "columns", "legend"}
    assert set(spec["panels"][0]["curves"][0]) == {"name", "x", "y", "colour", "dash", "kind"}


def test_curves_of_unlike_arrays_are_refused():
    with pytest.raises(InputError, match=r"curve 'a'.*x 3, y 2"):
        chart.Packing().spec(figure(chart.Curve("a", [1, 2, 3], [1, 2])))


def test_every_colour_a_law_gets_is_in_the_style_sheet_in_both_themes():
    colours = set(chart.law_colours([f"law {k}" for k in range(20)], "law 3").values())
    for word in colours | {"measured", "open", "ok", "fragile", "bad", "requirement", "muted"}:
        assert len(re.findall(rf"--uq-{word}:", chart.style())) >= 1, word


def test_the_component_asks_nothing_of_any_other_machine():
    without_notes = re.sub(r"/\*.*?\*/", "", chart.script() + chart.style(), flags=re.DOTALL)
    addresses = set(re.findall(r"https?://[^\s\"'`)]+", without_notes))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|import)\s*\(|@import", without_notes)


def test_a_mark_at_zero_is_kept_and_what_is_not_set_is_not():
    panel = chart.ChartPanel(
        chart.Axis("x"), chart.Axis("y"), [], marks=[chart.Mark("edge", y=0.0), chart.Mark("start", x=0.0)]
    )
    packed = chart.Packing().spec(panel)
    assert [(mark.get("x"), mark.get("y")) for mark in packed["marks"]] == [(None, 0.0), (0.0, None)]
    assert not {"height", "aspect", "equal", "tinted", "title"} & set(packed)
