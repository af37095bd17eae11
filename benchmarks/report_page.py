"""How long a browser takes to open the report of the packaged study, beside an empty page.

ULTRAQUIET_DEMO names the folder of a study walked before; without it the packaged one is walked first.
"""

import os
import shutil
import statistics
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ultraquiet import pipeline

FOLDER, OPENINGS, OPENS_S = "ULTRAQUIET_DEMO", 9, 1.0
TOOK_MS = "performance.timing.loadEventEnd - performance.timing.navigationStart"
DRAWN = "document.querySelectorAll('.uplot').length > 0"


def measure() -> Iterator[tuple[str, str, str, bool]]:
    """Yield the median of nine openings, each in a page of its own after an empty one."""
    if FOLDER in os.environ:
        yield _opened(Path(os.environ[FOLDER]) / "report.html")
        return
    with tempfile.TemporaryDirectory() as folder:
        suite = Path(pipeline.__file__).parent / "suite.toml"
        pipeline.walk(pipeline.load_study(suite), Path(folder) / "demo", suite.parent, say=print)
        yield _opened(Path(folder) / "demo" / "report.html")


def _opened(report: Path) -> tuple[str, str, str, bool]:
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as started:
        empty = Path(folder) / "empty.html"
        empty.write_text("<!doctype html><title>empty</title>", encoding="utf-8")
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        took = {empty: [], report.resolve(): []}
        for _ in range(OPENINGS):
            for file, seconds in took.items():
                page = browser.new_page(viewport={"width": 1280, "height": 1000})
                page.goto(file.as_uri())
                if file != empty:
                    page.wait_for_function(DRAWN)
                seconds.append(page.evaluate(TOOK_MS) / 1e3)
                page.close()
        browser.close()
    bare, full = (statistics.median(each) for each in took.values())
    figure = f"{full:.2f} s, an empty page {bare:.3f} s"
    return f"report of {report.stat().st_size / 1e6:.1f} MB: opened", figure, f"{OPENS_S:g} s", full < OPENS_S
