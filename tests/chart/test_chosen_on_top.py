"""Where curves lie over one another the chosen one is seen: on the page, in what the page saves and on paper."""

import io
import json

import numpy as np
import pytest

from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Packing, script, style
from ultraquiet.plot import draw_png
from ultraquiet.plot.page import figure_of

CHOSEN, OTHER = (0, 114, 178), (213, 94, 0)
X = np.linspace(0.0, 1.0, 50)
DRAWN = """async (s) => {
  const f = Uq.grid(document.getElementById("place"), JSON.parse(s));
  f.visible = true; f.layout();
  await new Promise((done) => setTimeout(done, 300));
  const { ctx } = f.plots[0], { width, height } = ctx.canvas;
  return {
    pixels: [...ctx.getImageData(0, 0, width, height).data],
    strokes: [...f.svg().matchAll(/stroke="(#[0-9a-f]{6})" stroke-width="1.5"/g)].map((m) => m[1]),
    legend: f.entries().map(([name]) => name), rows: f.csv().split("\\n").slice(1, -1).map((r) => r.split(",")[1]),
  };
}"""


def alike(kind):
    curves = [Curve(name, X, X**2, colour, kind=kind) for name, colour in (("quiet", "chosen"), ("twin", "law-1"))]
    return Chart("c", "C", "", [ChartPanel(Axis("x"), Axis("y"), curves)])


def count(pixels, colour):
    return int((np.abs(np.asarray(pixels).reshape(-1, 4)[:, :3].astype(int) - colour).max(axis=1) < 8).sum())


def drawn(browser, chart):
    """What a page shows of a chart and what it saves."""
    packing, page = Packing(), browser.new_page()
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    found = page.evaluate(DRAWN, json.dumps({**packing.spec(chart), "data": packing.data}))
    page.close()
    return found


@pytest.mark.web
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["line", "step", "path", "points", "bars", "stems"])
def test_of_two_curves_that_are_alike_the_page_shows_the_chosen_one(browser, kind):
    found = drawn(browser, alike(kind))
    if kind != "bars":  # those are transparent: both are seen
        assert count(found["pixels"], CHOSEN) > 50
        assert count(found["pixels"], OTHER) == 0
    if kind in ("line", "step", "path"):
        assert found["strokes"][-2:] == ["#d55e00", "#0072b2"]
    assert found["legend"] == ["quiet", "twin"]
    assert found["rows"] == ["quiet"] * X.size + ["twin"] * X.size


def test_so_does_paper():
    import matplotlib.image

    pixels = 255 * matplotlib.image.imread(io.BytesIO(draw_png(figure_of(alike("line")))))
    below = pixels[pixels.shape[0] // 3 :]  # the legend shows both
    assert count(below, CHOSEN) > 50
    assert count(below, OTHER) == 0


def measured_beside_a_twin():
    curves = [Curve("measured", X, X**2), Curve("model", X, X**2, "chosen")]
    return Chart("c", "C", "", [ChartPanel(Axis("x"), Axis("y"), curves)])


@pytest.mark.web
@pytest.mark.slow
def test_what_was_measured_is_seen_below_a_model_that_is_like_it(browser):
    found = drawn(browser, measured_beside_a_twin())
    dark = np.asarray(found["pixels"]).reshape(-1, 4)
    assert int(((dark[:, :3].max(axis=1) < 60) & (dark[:, 3] > 200)).sum()) > 50
    assert count(found["pixels"], CHOSEN) > 50


def test_and_on_paper():
    import matplotlib.image

    pixels = 255 * matplotlib.image.imread(io.BytesIO(draw_png(figure_of(measured_beside_a_twin()))))
    below = pixels[pixels.shape[0] // 3 :]
    alone = Chart("c", "C", "", [ChartPanel(Axis("x"), Axis("y"), [Curve("model", X, X**2, "chosen")])])
    plain = 255 * matplotlib.image.imread(io.BytesIO(draw_png(figure_of(alone))))[pixels.shape[0] // 3 :]
    assert count(below, CHOSEN) > 50
    assert count(below, (0, 0, 0)) > count(plain, (0, 0, 0)) + 200
