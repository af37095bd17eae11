"""What text takes room on a page: every word that is seen, in its elements and on its canvases, none over another.

`WATCH` goes into a page before its own scripts run: it notes each text that is drawn on a canvas, where and how, until
the canvas is cleared again. `faults` then compares what is there.
"""

from pathlib import Path

WATCH, FAULTS = (Path(__file__).with_name(name).read_text() for name in ("page_words_drawn.js", "page_faults.js"))


def faults(page):
    """Return what is wrong with where words stand on a page, and how many were looked at."""
    found = page.evaluate(FAULTS)
    return found["faults"], found["texts"]
