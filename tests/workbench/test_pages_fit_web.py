"""Every page in both themes at two widths: nothing overlaps, nothing is cut, no word of the program stands there."""

import pytest
from workbench_helpers import browser, finished_study, served

from chromium import SHOTS
from page_geometry import faults
from raw_words import raw_words

pytestmark = [pytest.mark.web, pytest.mark.slow]
PAGES = (
    "bench", "excite", "records", "spectra", "identify", "validate", "design", "reduce", "closed-loop", "deploy",
    "report",
)  # fmt: skip
NAMES = ("left front coil", "right front coil", "rear coil", "accelerometer 1", "accelerometer 2", "geophone", "laser")
STUDIES = {"six": (6, 6), "four-by-three": (3, 4, NAMES, "An optical table on three coils, from a CSV of 2026")}
SCROLLED = """async () => {
  for (let y = 0; y < document.documentElement.scrollHeight; y += innerHeight / 2) {
    scrollTo(0, y);
    await new Promise((done) => setTimeout(done, 150));
  }
  scrollTo(0, 0);
}"""
BLANK = """() => [...document.querySelectorAll("[data-testid$='-chart'][data-drawn]")]
  .filter((e) => e.offsetParent && e.offsetHeight > 100 && !e.querySelector("canvas, svg"))
  .map((e) => e.dataset.testid)"""


# What a reader is shown, without the lines of Python and the names of files.
SHOWN = """() => [...document.querySelectorAll("header, .uq-boards, .uq-main, .uq-side")].map((e) => {
  const copy = e.cloneNode(true);
  copy.querySelectorAll("pre, code, .uq-lines, .q-icon, a[href^='/study/']").forEach((e) => e.remove());
  return [...copy.querySelectorAll("*")].filter((e) => !e.children.length).map((e) => e.textContent).join("\\n");
}).join("\\n")"""


@pytest.fixture(scope="module", params=STUDIES)
def study(request, tmp_path_factory):
    """A study with a law and its code: as many inputs as outputs, and fewer, of long names."""
    return finished_study(tmp_path_factory.mktemp("fits") / request.param, *STUDIES[request.param])


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080)], ids=["1280", "1920"])
def test_every_page_fits_its_window(study, size, scheme):
    pictures = SHOTS / "workbench" / study.name
    pictures.mkdir(exist_ok=True, parents=True)
    wrong = {}
    with served(study) as made, browser(made, *size, scheme) as seen:
        for page in PAGES:
            seen.go(page)
            if page not in ("bench", "deploy", "report"):
                seen.find("main", "canvas")
            seen.page.wait_for_timeout(1500)
            seen.page.wait_for_function("() => !document.querySelector(`[data-testid='busy']`).innerText")
            seen.page.evaluate(SCROLLED)  # a figure is drawn when it comes into view
            blank = seen.page.evaluate(BLANK)
            assert blank == [], f"{page} leaves figures blank"
            seen.page.screenshot(path=pictures / f"{page}-{size[0]}-{scheme}.png", full_page=True)
            wide = seen.page.evaluate("document.documentElement.scrollWidth")
            assert wide <= size[0], f"{page} is {wide} wide"
            unmarked = seen.page.evaluate(
                "[...document.querySelectorAll('button, input:not([type=hidden]), a')].filter((e) => e.offsetParent && "
                "!e.closest('[data-testid]')).map((e) => e.outerHTML.slice(0, 120))"
            )
            assert unmarked == [], page
            found, texts = faults(seen.page)
            assert texts > 30, f"{page} shows words"
            raw = raw_words(seen.page.evaluate(SHOWN))
            if found or raw:
                wrong[page] = [*found, *(f"raw: {word}" for word in raw)]
        assert seen.errors == []
        assert seen.outside == []
    print(wrong)
    assert wrong == {}


CROWDED = """<!doctype html><body style="font: 16px sans-serif">
<p style="position: absolute; left: 8px; top: 8px">one sentence</p>
<p style="position: absolute; left: 40px; top: 12px">another one</p>
<div style="position: absolute; top: 90px; width: 40px; overflow: hidden; white-space: nowrap">too long for it</div>
<input style="position: absolute; top: 130px; width: 40px" value="too long for its field">
<div class="wide" style="position: absolute; top: 160px; width: 90px; overflow-x: auto"><table><tr><td
  style="white-space: nowrap">columns that are scrolled away</table></div>
<canvas width=200 height=60 style="position: absolute; top: 200px"></canvas>
<script>const pen = document.querySelector("canvas").getContext("2d"); pen.font = "14px sans-serif";
pen.fillText("first", 10, 20); pen.fillText("second", 30, 20); pen.fillText("beyond the edge", 150, 50);</script>"""


def test_what_overlaps_or_is_cut_is_found(browser_page):
    """The measure that the test above trusts sees every fault that it is there for."""
    browser_page.set_content(CROWDED)
    found, texts = faults(browser_page)
    print(found)
    assert texts >= 6
    for word in (
        "overlap: 'one sentence'",
        "cut: 'too long",
        "cut in its field",
        "touch in a figure",
        "beyond its figure",
        "hidden beyond its place",
    ):
        assert any(fault.startswith(word) for fault in found), word


@pytest.fixture
def browser_page():
    """An empty page whose words are noted."""
    from chromium import chromium_started
    from page_geometry import WATCH

    with chromium_started() as chrome:
        context = chrome.new_context()
        context.add_init_script(WATCH)
        yield context.new_page()
