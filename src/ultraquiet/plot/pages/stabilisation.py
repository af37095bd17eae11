"""The stabilisation diagram: poles over frequency, one order above the other; those of the plant stay in line."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark, decibel_axis, frequency_axis

# From one order to the next a mode keeps its frequency and its damping within these shares.
SAME_HZ, SAME_DAMPING = 0.01, 0.05
IN_LINE = 3  # orders in which a mode must stand still to be named
MOST_NAMED = 8
LOOKS = {  # what a pole keeps from the order before -> colour and symbol
    "new": ("open", "."),
    "keeps its frequency": ("law-4", "+"),
    "keeps frequency and damping": ("chosen", "o"),
}


def stabilisation(
    roots: Mapping[int, FloatArray],
    limits_hz: tuple[float, float],
    taken: int | None,
    gain: tuple[FloatArray, FloatArray, str] | None = None,
) -> Chart:
    """Return the poles of every order, and below them the largest gain.

    Args:
        roots: frequency in Hz and damping `(m, 2)` of the poles of each order, conjugates counted once.
        limits_hz: frequencies that are shown.
        taken: the order of the study's model, where it is one of them.
        gain: lines in Hz, largest singular value there `(nf,)`, and what it is relative to.
    """
    orders = sorted(roots)
    kept = {n: _kept(roots[n], roots[before] if (before := n - _step(orders)) in roots else None) for n in orders}
    curves = []
    for level, (word, (colour, symbol)) in enumerate(LOOKS.items()):
        at = [(f, n) for n in orders for (f, _), k in zip(roots[n], kept[n], strict=True) if k == level]
        inside = [(f, n) for f, n in at if limits_hz[0] <= f <= limits_hz[1]]
        if inside:
            f, n = np.array(inside, dtype=float).T
            curves.append(Curve(word, f, n, colour, kind="points", symbol=symbol))
    marks = [] if taken is None else [Mark(f"order taken: {taken}", y=float(taken), colour="bad")]
    spread = (min(orders) - 1.0, max(orders) + 1.0)
    x = frequency_axis(*limits_hz)
    panels = [ChartPanel(x, Axis("order", ticks="int", range=spread), curves, "", (), marks, height=300)]
    if gain is not None:
        f_hz, size, unit = gain
        line = Curve("largest singular value", f_hz, 20 * np.log10(np.maximum(size, np.finfo(float).tiny)), "open")
        panels.append(ChartPanel(x, decibel_axis("gain", unit), [line], height=190))
    return Chart("stabilisation", "Stabilisation diagram", _told(roots, limits_hz), panels)


def _step(orders: list[int]) -> int:
    return min((b - a for a, b in pairwise(orders)), default=1)


def _kept(now: FloatArray, before: FloatArray | None) -> list[int]:
    """Return of each pole 0 where it is new, 1 where the order before had its frequency, 2 where its damping too."""
    if before is None or not len(before):
        return [0] * len(now)
    return [2 if _stands(pole, before) else 1 if len(_near(pole, before)) else 0 for pole in now]


def _near(pole: FloatArray, roots: FloatArray) -> FloatArray:
    """Return those of an order's poles that have the frequency of this one."""
    return roots[np.abs(roots[:, 0] - pole[0]) <= SAME_HZ * pole[0]]


def _stands(pole: FloatArray, roots: FloatArray) -> bool:
    """Return whether one of an order's poles has this one's frequency and damping."""
    return bool((np.abs(_near(pole, roots)[:, 1] - pole[1]) <= SAME_DAMPING * abs(pole[1])).any())


def _told(roots: Mapping[int, FloatArray], limits_hz: tuple[float, float]) -> str:
    """Say which modes stand in line at the highest orders."""
    orders = sorted(roots)
    last = orders[-IN_LINE:]
    lines = [
        (float(pole[0]), float(pole[1]))
        for pole in roots[orders[-1]]
        if limits_hz[0] <= pole[0] <= limits_hz[1] and 0 < pole[1] < 1
        if all(_stands(pole, roots[n]) for n in last)
    ]
    least = sorted(sorted(dict.fromkeys(lines), key=lambda each: each[1])[:MOST_NAMED])
    named = ", ".join(f"{f:.4g} Hz ({100 * zeta:.2g} %)" for f, zeta in least)
    rule = (
        f"A pole that keeps its frequency within {100 * SAME_HZ:g} % and its damping within {100 * SAME_DAMPING:g} % "
        f"from one order to the next is likely the plant's; one that wanders is noise."
    )
    if not least:
        return f"{rule} None stands still over the last {len(last)} orders."
    most = "; the least damped of those" if len(lines) > len(least) else ""
    return f"{rule} In line over the last {len(last)} orders{most}, with damping: {named}."
