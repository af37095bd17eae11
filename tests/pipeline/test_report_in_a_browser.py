"""The report of three unlike studies in a browser: nothing fetched, every figure readable, zoom linked, print whole."""

import base64
import csv
import io
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from test_any_bench import LIST, STUDY, TABLE, TWO_MASSES

from chromium import SHOTS
from page_geometry import WATCH, faults
from ultraquiet.pipeline import load_study, walk

pytestmark = [pytest.mark.web, pytest.mark.slow]
MOST_BYTES, MOST_STILL_BYTES = 4_000_000, 60_000
STUDIES = ("demo", "two-masses", "four-by-three")
# Quantities that are numbers by themselves.
BARE = ("order",)


def made(folder, files, words):
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    walk(load_study(folder / "study.toml"), folder / "out", folder, say=words.append)
    return folder / "out" / "report.html"


def a_table(rng):
    """Three forces, four speeds at 2 kHz, as another program would have written them."""
    u = rng.standard_normal((3, 4000))
    y = np.zeros((4, 4000))
    for k, f in enumerate((40.0, 75.0, 130.0, 210.0)):
        pole = np.exp(2j * np.pi * f / 2000 - 0.06 * f / 2000)
        state, drive = 0j, rng.standard_normal(3) @ u
        for t in range(4000):
            y[k, t] = state.imag
            state = pole * state + 1e-3 * drive[t]
    head = ",".join([*(f"f{k + 1} [N]" for k in range(3)), *(f"v{k + 1} [m/s]" for k in range(4))])
    out = io.StringIO()
    np.savetxt(out, np.vstack([u, y + 1e-5 * rng.standard_normal(y.shape)]).T, delimiter=",", header=head, comments="")
    return out.getvalue()


@pytest.fixture(scope="module", params=STUDIES)
def report(request, tmp_path_factory):
    """The report of one study."""
    if request.param == "demo":
        return request.getfixturevalue("demo")[0] / "report.html"
    folder, words = tmp_path_factory.mktemp("studies"), []
    asked = '\n[requirements]\nlaw = "quiet"\nattenuation_db = 3.0\npeak_db = 8.0\n'
    if request.param == "two-masses":
        files = {"two_masses.py": TWO_MASSES, "list.toml": LIST, "study.toml": STUDY + asked}
        return made(folder / "two", files, words)
    return made(folder / "table", {"run.csv": a_table(np.random.default_rng(1)), "study.toml": TABLE}, words)


@pytest.fixture
def opened(browser, report):
    """A function that opens the report at a width in a theme; what went wrong is in `page.wrong`."""
    pages = []

    def open_it(width=1280, theme="light", drawn=True):
        page = browser.new_page(viewport={"width": width, "height": 1000}, color_scheme=theme)
        page.add_init_script(WATCH)
        page.wrong, page.asked = [], []
        page.on("console", lambda said: page.wrong.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: page.wrong.append(str(error)))
        page.on("request", lambda request: page.asked.append(request.url))
        page.goto(report.as_uri())
        if drawn:
            page.evaluate("Uq.figures.forEach(f => { f.visible = true; f.layout(); })")
            page.wait_for_timeout(300)
        pages.append(page)
        return page

    yield open_it
    for page in pages:
        page.close()


def test_nothing_is_fetched_and_nothing_goes_wrong(opened, report):
    page = opened()
    assert page.wrong == []
    assert {url for url in page.asked if not url.startswith("data:")} == {report.as_uri()}


def test_it_is_small_and_every_number_stands_in_it_once(report):
    text = report.read_text(encoding="utf-8")
    stills = [len(base64.b64decode(still)) for still in re.findall(r"base64,([^\"]+)\"", text)]
    data = json.loads(re.search(r'id="uq-data">(.*?)</script>', text, re.DOTALL)[1])
    print(f"{len(text.encode()) / 1e6:.2f} MB, {len(stills)} stills, largest {max(stills) / 1e3:.0f} kB")
    assert len(text.encode()) < MOST_BYTES
    assert max(stills) <= MOST_STILL_BYTES
    assert len(set(data.values())) == len(data)


def test_what_is_not_in_view_is_not_drawn_at_opening(opened):
    """How long opening takes, which this keeps short, is measured by the benchmark `report_page`."""
    page = opened(drawn=False)
    page.wait_for_function("document.querySelectorAll('.uplot').length > 0")
    page.wait_for_timeout(500)
    drawn, all_of_them = page.evaluate("[[...Uq.figures].filter(f => f.visible).length, [...Uq.figures].length]")
    print(f"{drawn} of {all_of_them} figures are drawn at opening")
    assert 0 < drawn < all_of_them


GEOMETRY = """() => [...Uq.figures].map(f => {
  const box = e => { const b = e.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; };
  return {
    title: f.spec.title,
    panels: f.panels.map(p => ({ x: p.panel.x.label, y: p.panel.y.label, names: p.panel.x.names, bare: p.bare,
      curves: p.curves.length, place: box(p.place), range: [p.plot.scales.y.min, p.plot.scales.y.max] })),
    legend: f.legend.hidden ? null : box(f.legend),
    unnamed: f.panels.flatMap(p => p.curves).filter(c => !c.name).length,
  };
})"""


def test_every_axis_has_its_unit_and_no_legend_lies_on_a_curve(opened):
    figures = opened().evaluate(GEOMETRY)
    print(f"{len(figures)} figures, {sum(len(f['panels']) for f in figures)} panels")
    assert len(figures) >= 8
    for figure in figures:
        for panel in figure["panels"]:
            assert panel["curves"], figure["title"]
            for label in (panel["y"], *([] if panel["names"] else [panel["x"]])):
                assert re.search(r"\(.+\)$", label) or label in BARE, (figure["title"], label)
            low, high = panel["range"]
            assert high > low, figure["title"]
            if figure["legend"] is not None:
                assert not overlap(figure["legend"], panel["place"]), figure["title"]
        places = [p["place"] for p in figure["panels"]]
        assert not any(overlap(a, b) for k, a in enumerate(places) for b in places[:k]), figure["title"]


def overlap(a, b):
    """Whether two boxes (left, top, right, bottom) share more than an edge."""
    return min(a[2], b[2]) - max(a[0], b[0]) > 1 and min(a[3], b[3]) - max(a[1], b[1]) > 1


FRAME = "(() => { const f = [...Uq.figures].find(f => f.spec.name === 'response'); return f; })()"


def test_a_zoom_holds_for_the_whole_figure_and_two_clicks_undo_it(opened):
    page = opened()
    home = page.evaluate(f"{FRAME}.plots.map(p => [p.scales.x.min, p.scales.x.max])")
    others = page.evaluate("[...Uq.figures].filter(f => f.spec.name !== 'response').map(f => f.plots[0].scales.x.max)")
    over = page.locator("[data-chart=response] .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 25, steps=4)
    page.mouse.up()
    zoomed = page.evaluate(f"{FRAME}.plots.map(p => [p.scales.x.min, p.scales.x.max])")
    assert len({tuple(span) for span in zoomed}) == 1
    assert home[0][0] < zoomed[0][0] < zoomed[0][1] < home[0][1]
    assert others == page.evaluate(
        "[...Uq.figures].filter(f => f.spec.name !== 'response').map(f => f.plots[0].scales.x.max)"
    )
    page.mouse.dblclick(box["x"] + 0.5 * box["width"], box["y"] + 20)
    page.wait_for_timeout(400)
    assert page.evaluate(f"{FRAME}.plots.map(p => [p.scales.x.min, p.scales.x.max])") == home
    assert page.locator("dialog").count() == 0


def test_one_click_enlarges_a_channel_with_its_phase(opened):
    page = opened()
    if page.evaluate(f"!{FRAME}.spec.enlarge"):
        pytest.skip("one channel stands with its phase anyway")
    over = page.locator("[data-chart=response] .u-over").nth(1)
    over.scroll_into_view_if_needed()
    over.click()
    page.locator("dialog").wait_for()
    page.wait_for_timeout(300)
    labels = page.evaluate("[...Uq.figures].at(-1).panels.map(p => p.panel.y.label)")
    assert "phase (°)" in labels
    page.keyboard.press("Escape")
    page.wait_for_timeout(100)
    assert page.locator("dialog").count() == 0


def test_a_curve_is_switched_and_the_readout_tells_all(opened):
    page = opened()
    entry = page.locator("[data-chart=response] .uq-entry", has_text="design plant")
    entry.scroll_into_view_if_needed()
    entry.click()
    assert entry.get_attribute("aria-pressed") == "false"
    assert page.evaluate(f"{FRAME}.hidden.has('design plant')")
    entry.click()
    over = page.locator("[data-chart=response] .u-over").first
    over.scroll_into_view_if_needed()
    over.hover()
    page.wait_for_timeout(50)
    assert re.search(r"\d", entry.inner_text())
    assert re.search(r"at [\d.]+ Hz", page.locator("[data-chart=response] .uq-at").inner_text())


def test_numbers_and_pictures_leave_the_page(opened):
    page = opened()
    with page.expect_download() as saved:
        page.locator("[data-chart=loops] .uq-tool", has_text="CSV").click()
    rows = list(csv.DictReader(Path(saved.value.path()).read_text().splitlines()))
    assert {row["x label"] for row in rows} == {"frequency (Hz)"}
    assert all(np.isfinite(float(row["x"])) for row in rows)
    drawing = ElementTree.fromstring(page.evaluate("[...Uq.figures].find(f => f.spec.name === 'loops').svg()"))
    assert len(drawing.findall(".//{http://www.w3.org/2000/svg}path")) > 20
    with page.expect_download() as saved:
        page.locator("[data-chart=loops] .uq-tool", has_text="PNG").click()
    assert Path(saved.value.path()).read_bytes()[:4] == b"\x89PNG"


def test_a_table_is_sorted_by_the_head_that_is_clicked(opened):
    page = opened()
    head = page.locator("section table.sortable thead th:visible").nth(1)
    head.click()
    assert head.get_attribute("aria-sort") == "ascending"
    head.click()
    assert head.get_attribute("aria-sort") == "descending"


@pytest.mark.parametrize("width", [1280, 1920])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_both_themes_at_both_widths(theme, width, opened, report):
    page = opened(width, theme)
    assert page.wrong == []
    found, texts = faults(page)
    assert texts > 200
    assert found == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    light = page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert light == (theme == "light")
    front = page.locator("header.front").bounding_box()
    print(f"first page {front['height']:.0f} px high")
    assert front["height"] < 1000, "the answer, the table and the picture stand on one screen"
    folder = SHOTS / f"{report.parent.name}-{report.parent.parent.name}"
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=folder / f"{theme}-{width}.png", full_page=True)
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != ("rgb(255, 255, 255)" if light else "")


CAPTIONS = """() => [...document.querySelectorAll("caption")].filter((c) => c.checkVisibility()).map((c) => {
  const line = document.createRange();
  line.selectNodeContents(c);
  return [c.textContent, c.getBoundingClientRect().width, line.getClientRects().length];
})"""


def test_no_caption_is_a_thin_column_in_print(opened):
    """A caption is as wide as its words, or takes the better part of the page's width."""
    page = opened(width=688)  # of A4 within its margins
    page.emulate_media(media="print")
    captions = page.evaluate(CAPTIONS)
    assert captions
    assert not [text for text, width, lines in captions if lines > 1 and width < 400]


def test_without_scripts_the_stills_stand_in_for_the_charts(browser, report):
    page = browser.new_page(java_script_enabled=False)
    page.goto(report.as_uri())
    stills = page.locator("img.still")
    assert stills.count() >= 8
    assert stills.first.is_visible()
    page.close()


# Chromium writes where the target of each link lands, so a link to a block makes the PDF say on which page it is.
MARK = """() => {
  const blocks = {};
  const mark = (e, block, part) => {
    e.id = `at-${block}-${part}`;
    const link = document.createElement("a");
    link.href = "#" + e.id; link.hidden = true;
    document.body.append(link);
  };
  const end = e => e.appendChild(document.createElement("span"));
  const add = (name, parts) => {
    const block = Object.keys(blocks).length;
    blocks[block] = name;
    parts.forEach((e, k) => mark(e, block, k));
  };
  document.querySelectorAll("figure").forEach(f => {
    const [title, caption] = [f.querySelector("strong"), f.querySelector("figcaption")];
    add("figure: " + title.innerText, [title, f.querySelector("img"), caption, end(caption)]);
  });
  document.querySelectorAll("table").forEach(t => {
    const rows = [...t.rows];
    add("table: " + t.caption.innerText, [t.caption, ...(t.classList.contains("short") ? rows : rows.slice(0, 2))]);
  });
  document.querySelectorAll("h2").forEach(h => add("title: " + h.innerText, [h, h.nextElementSibling]));
  document.querySelectorAll("section > p").forEach(p => add("text: " + p.innerText.slice(0, 40), [p, end(p)]));
  add("answer", [...document.querySelectorAll(".headline, .front figure img, .front dl")]);
  return blocks;
}"""


def printed_places(pdf):
    """Return {block: [(page, height) of its parts]} of the marks that the PDF keeps as named destinations."""
    places = {}
    for block, part, page, height in re.findall(rb"/at-(\d+)-(\d+) \[(\d+) 0 R /XYZ \S+ (\S+) ", pdf):
        places.setdefault(block.decode(), {})[int(part)] = int(page), float(height)
    return {block: [parts[k] for k in sorted(parts)] for block, parts in places.items()}


def test_a_printed_page_splits_no_block(opened, report, tmp_path):
    """Title, picture and caption stand on one page, and so do short tables, a long one's head, a title and its text."""
    page = opened()
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    blocks = page.evaluate(MARK)
    pdf = page.pdf(path=tmp_path / "report.pdf", format="A4")
    places = printed_places(pdf)
    assert places.keys() == blocks.keys(), "every block lands somewhere"
    split = [blocks[k] for k, parts in places.items() if len({number for number, _ in parts}) > 1]
    pages = len(re.findall(rb"/Type /Page\b", pdf))
    kinds = {kind: sum(b.startswith(kind) for b in blocks.values()) for kind in ("figure", "table", "title", "text")}
    print(f"{pages} pages, {kinds}, split: {split}")
    assert kinds["figure"] >= 8
    assert not split
    if shutil.which("pdftoppm"):
        folder = SHOTS / f"{report.parent.name}-{report.parent.parent.name}"
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["pdftoppm", "-r", "60", "-png", tmp_path / "report.pdf", folder / "printed"], check=True)


def test_waiting_is_not_what_makes_it_quick(opened):
    """Figures are drawn when they come into view, so a page of many opens as quickly as one of few."""
    page = opened(drawn=False)
    before = page.locator(".uplot").count()
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    started = time.monotonic()
    page.wait_for_function(f"document.querySelectorAll('.uplot').length > {before}")
    assert time.monotonic() - started < 5
