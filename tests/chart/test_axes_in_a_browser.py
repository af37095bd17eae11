"""Every kind of curve on every kind of axis in a browser: none hangs the page, whatever the numbers are."""

import itertools
import json

import numpy as np
import pytest

from page_geometry import WATCH
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, HeatMap, Mark, MovingShape, Packing, Scene, script, style

pytestmark = [pytest.mark.web, pytest.mark.slow]
KINDS = ("line", "step", "path", "points", "bars", "stems")
X = (np.arange(8.0), np.linspace(-2.0, 2.0, 8), np.zeros(8), np.array([3.0, 0.0, -1.0, 2.0, 5.0, 1.0, 4.0, 6.0]))
Y = (np.linspace(-1.0, 1.0, 8), np.zeros(8), np.full(8, np.nan), np.geomspace(1e-30, 1e30, 8), np.full(8, 1e17))

DRAW = """(s) => { window.drawn = null; setTimeout(() => {
  const f = Uq.grid(document.getElementById("place"), JSON.parse(s));
  f.visible = true; f.layout(); f.svg(); f.csv();
  window.drawn = f.plots.filter((p) => p).length; f.destroy();
}); }"""


def cases():
    """Charts of all kinds, scales and numbers, as a page takes them."""
    for kind, scale_x, scale_y in itertools.product(KINDS, ("linear", "log"), ("linear", "log")):
        panels = [
            ChartPanel(Axis("x", scale_x, span), Axis("y", scale_y, span), [Curve("c", x, y, kind=kind, width=0.5)])
            for x, y in itertools.product(X, Y)
            if kind in ("path", "points", "bars", "stems") or (np.diff(x) > 0).all()
            for span in (None, (0.0, 5.0))
        ]
        marked = [ChartPanel(p.x, p.y, p.curves, marks=[Mark("m", y=0.0), Mark("n", x=0.0)]) for p in panels]
        yield f"{kind}, {scale_x} over {scale_y}", Chart("c", "C", "", [*panels, *marked], 4)


def test_no_axis_hangs_the_page(browser):
    page = browser.new_page()
    page.set_default_timeout(20_000)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    for name, chart in cases():
        packing = Packing()
        spec = json.dumps({**packing.spec(chart), "data": packing.data})
        page.evaluate(DRAW, spec)
        page.wait_for_function("window.drawn !== null", polling=50)  # times out where the page hangs
        assert page.evaluate("window.drawn") == len(chart.panels), name
    assert wrong == []
    page.close()


def test_what_has_little_room_says_its_unit_and_orders_are_whole(browser):
    """A label that does not fit is its unit, brackets within it and all; between whole numbers there is none."""
    page = browser.new_page()
    page.add_init_script(WATCH)
    page.goto("about:blank")
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    labels = ("gain (dB re (m/s)/N)", "what stands there of it (dB re N/(m/s))")
    panels = [ChartPanel(Axis("order", ticks="int"), Axis(y), [Curve("c", [4.0], [1.0])], height=160) for y in labels]
    packing = Packing()
    kept = DRAW.replace("f.destroy();", "")
    page.evaluate(kept, json.dumps({**packing.spec(Chart("c", "C", "", panels)), "data": packing.data}))
    page.wait_for_function("window.drawn === 2")
    words = page.evaluate("[...document.querySelectorAll('canvas')].map((c) => c.words.map(([t]) => t))")
    for drawn, unit in zip(words, ("dB re (m/s)/N", "dB re N/(m/s)"), strict=True):
        assert unit in drawn
        assert not [word for word in drawn if "\u2026" in word]
        assert drawn[drawn.index("order") + 1 : drawn.index(unit)] == ["4"]
    page.close()


SCENE = """async (s) => {
  const place = document.getElementById("place"), scene = Uq.scene(place, JSON.parse(s));
  const look = () => place.querySelector("canvas").toDataURL();
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  await wait(300);
  const first = look();
  await wait(300);
  const second = look();
  place.querySelector("button").click();
  await wait(100);
  const third = look();
  await wait(300);
  return { moves: first !== second, stops: third === look(), lines: scene.csv().trim().split("\\n").length };
}"""


def test_shapes_move_until_they_are_stopped(browser):
    shape = MovingShape("one", [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros((2, 3)))
    scene = Scene("s", "S", "", [[0.0, 0.0, 0.0], [0.0, 1.0, 1.0]], [(0, 1)], [shape])
    packing = Packing()
    spec = json.dumps({**packing.spec(scene), "data": packing.data})
    page = browser.new_page()
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    assert page.evaluate(SCENE, spec) == {"moves": True, "stops": True, "lines": 3}
    page.close()


MAP = """async (s) => {
  const f = Uq.grid(document.getElementById("place"), JSON.parse(s));
  f.visible = true; f.layout();
  await new Promise((done) => setTimeout(done, 300));
  const p = f.panels[0], u = p.plot, X = (x, c) => u.valToPos(x, "x", c), Y = (y, c) => u.valToPos(y, "y", c);
  const at = (x, y) => p.values(X(x), Y(y))["level (dB), 0 to 8"];
  const pixel = (x, y) => [...u.ctx.getImageData(X(x, true) + 3, Y(y, true) + 3, 1, 1).data];
  return {
    read: [at(1, 1), at(3, 100), at(2, 10)], dark: pixel(1, 1), bright: pixel(3, 100),
    rows: f.csv().trim().split("\\n"), svg: f.svg().includes("<image"),
  };
}"""


def test_values_as_colours_are_drawn_saved_and_read(browser):
    shown = HeatMap("level (dB)", [1.0, 2.0, 3.0], [1.0, 10.0, 100.0], np.arange(9.0), (0.0, 8.0))
    panel = ChartPanel(Axis("time (s)"), Axis("frequency (Hz)", "log"), [], map=shown)
    packing = Packing()
    spec = json.dumps({**packing.spec(Chart("m", "M", "", [panel])), "data": packing.data})
    page = browser.new_page()
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    found = page.evaluate(MAP, spec)
    page.close()
    assert found["read"] == ["0", "8", "4"]
    assert found["dark"][2] > found["dark"][1]
    assert found["bright"][0] > 200
    assert found["bright"][1] > 200
    assert len(found["rows"]) == 10
    assert found["rows"][-1].endswith(",8")
    assert found["svg"]


TITLES = """(s) => {
  const place = document.getElementById("place"), f = Uq.grid(place, JSON.parse(s));
  f.visible = true; f.layout();
  const tops = f.panels.map((p) => p.place.getBoundingClientRect().top), svg = f.svg();
  return f.panels.map((p, k) => ({
    shown: p.title.textContent, told: p.title.title, cut: p.title.scrollWidth > p.title.clientWidth, top: tops[k],
    saved: p.title.textContent.split("\\n").every((row) => svg.includes(">" + row + "<")),
  }));
}"""


@pytest.mark.parametrize("width", [1200, 520, 360])
def test_titles_are_whole_or_told_whole_and_curves_begin_at_one_height(browser, width):
    """A title without room is folded; of one that is longer than its rows the whole is told."""
    said = ["f", "right front coil → accelerometer 1", "p", "a " * 60 + "b", "x" * 200, "rear coil → geophone"]
    curve = Curve("c", np.arange(3.0), np.arange(3.0))
    panels = [ChartPanel(Axis("x (s)"), Axis("y (V)"), [curve], title=title) for title in said]
    packing = Packing()
    spec = json.dumps({**packing.spec(Chart("t", "T", "", panels, 3)), "data": packing.data})
    page = browser.new_page()
    page.set_content(f"<style>{style()}</style><div id=place style='width: {width}px'></div>")
    page.add_script_tag(content=script())
    found = page.evaluate(TITLES, spec)
    page.close()
    for title, one in zip(said, found, strict=True):
        whole = one["shown"].replace("\n", " ") == title
        assert one["told"] == ("" if whole else title)
        assert whole or len(title) > 40, title
        assert not one["cut"], title
        assert one["saved"], title
    if width == 520:
        assert found[1]["shown"] == "right front coil →\naccelerometer 1"
    assert [len({one["top"] for one in found[k : k + 3]}) for k in (0, 3)] == [1, 1]


EQUAL = """(s) => {
  const f = Uq.grid(document.getElementById("place"), JSON.parse(s));
  f.visible = true; f.layout(); window.figure = f;
}"""
SCALES = """() => window.figure.plots.map((u) => [
  u.bbox.width / (u.scales.x.max - u.scales.x.min), u.bbox.height / (u.scales.y.max - u.scales.y.min),
  u.scales.x.min, u.scales.x.max, u.scales.y.min, u.scales.y.max])"""


def shown(browser, chart, width):
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.set_content(f"<style>{style()}</style><div id=place></div>")
    page.add_script_tag(content=script())
    packing = Packing()
    page.evaluate(EQUAL, json.dumps({**packing.spec(chart), "data": packing.data}))
    page.wait_for_timeout(300)
    return page


@pytest.mark.parametrize("width", [300, 640, 1280, 1920])
def test_a_circle_is_round_at_any_width_and_zoom(browser, width):
    angle = np.linspace(0, 2 * np.pi, 91)
    circle = Curve("unit circle", np.cos(angle), np.sin(angle), kind="path")
    plain = ChartPanel(Axis("real part"), Axis("imaginary part"), [circle], equal=True)
    sized = ChartPanel(
        Axis("re", range=(-3, 1)), Axis("im", range=(-1, 1)), [circle], height=400, aspect=1.2, equal=True
    )
    for panel in (plain, sized):
        page = shown(browser, Chart("c", "C", "", [panel]), width)
        for zoomed in (False, True, True):
            across, up, left, right, low, high = page.evaluate(SCALES)[0]
            assert abs(across / up - 1) < 0.01, (width, zoomed)
            if not zoomed:
                assert left <= -1
                assert right >= 1
                assert low <= -1
                assert high >= 1
                page.evaluate("window.figure.zoom(0.5, 1.0)")
            else:
                page.set_viewport_size({"width": width + 40, "height": 900})
            page.wait_for_timeout(200)
        page.close()


def test_the_y_axis_fits_what_a_zoom_shows(browser):
    x = np.linspace(0, 10, 101)
    page = shown(browser, Chart("c", "C", "", [ChartPanel(Axis("x"), Axis("y"), [Curve("c", x, x**2)])]), 900)
    for lo, hi in ((1.0, 2.0), (5.0, 6.0)):
        page.evaluate(f"window.figure.zoom({lo}, {hi})")
        page.wait_for_timeout(100)
        _, _, left, right, low, high = page.evaluate(SCALES)[0]
        assert (left, right) == (lo, hi)
        assert lo**2 - 3 < low <= lo**2
        assert hi**2 <= high < hi**2 + 3
    page.close()


def test_names_stand_alike_in_all_panels_of_a_row(browser):
    """Where the names of one panel have no room side by side, those of its neighbours stand upright too."""

    def bars(names):
        across = Axis("channel", range=(-0.5, len(names) - 0.5), names=names)
        return ChartPanel(across, Axis("y"), [Curve("c", np.arange(len(names)), np.ones(len(names)), kind="bars")])

    few, many = ["left front coil", "rear coil"], [f"accelerometer {k + 1}" for k in range(9)]
    for names, turned in (([few, many], -90), ([few, few], 0)):
        page = shown(browser, Chart("c", "C", "", [bars(each) for each in names], 2), 900)
        turns = page.evaluate("window.figure.plots.map((u) => u.axes[0].rotate())")
        assert turns == [turned, turned]
        assert len(set(page.evaluate("window.figure.plots.map((u) => u.bbox.height)"))) == 1
        page.close()
