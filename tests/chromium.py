"""The system's Chromium for tests of pages: one place that finds it, starts it and ends it, and where pictures go."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or ""
# What the tests draw is kept here to be looked at.
SHOTS = Path(os.environ.get("ULTRAQUIET_ARTEFACTS", Path(__file__).parents[1] / "artefacts"))


@contextmanager
def chromium_started() -> Iterator[Any]:
    """Start Chromium for the length of a block; skip where Playwright or Chromium is missing."""
    playwright = pytest.importorskip("playwright.sync_api")
    if not CHROMIUM:
        pytest.skip("no Chromium on this machine")
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield chromium
        finally:
            chromium.close()
