"""Which colour means what: a law keeps its colour from page to page."""

from collections.abc import Iterable

LAWS = 8  # colours in chart.css for laws that were not chosen


def law_colours(names: Iterable[str], chosen: str | None = None) -> dict[str, str]:
    """Return the colour of every law: the chosen one's own, the others' in the order of their names.

    >>> law_colours(["lqg", "quiet", "hinf"], chosen="quiet")
    {'hinf': 'law-1', 'lqg': 'law-2', 'quiet': 'chosen'}
    """
    others = (name for name in sorted(set(names)) if name != chosen)
    colours = {name: f"law-{k % LAWS + 1}" for k, name in enumerate(others)}
    if chosen is not None and chosen in set(names):
        colours[chosen] = "chosen"
    return dict(sorted(colours.items()))
