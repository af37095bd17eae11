"""A curve the size of a word."""

from typing import Any, cast

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import attributes

WIDTH, HEIGHT, EDGE = 160, 28, 2.0
POINTS = 80
FEWEST = 8  # numbers that make a curve
AXES = ("f_hz", "time_s", "tones_hz", "centre_hz", "x")
FIRST = ("model", "controller", "response", "S", "bench")  # what a result is about
DEEPEST = 3  # objects within objects that are looked into


def sparkline(values: FloatArray) -> str:
    """Return numbers `(n,)` as a small SVG element; each step of its width spans what is smallest and largest there.

    >>> sparkline(np.arange(9.0)).count("polyline"), sparkline(np.zeros(0))
    (1, '')
    """
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if finite.size < 2:
        return ""
    if finite.size > POINTS:
        bins = np.array_split(finite, POINTS // 2)
        finite = np.array([end for each in bins for end in (each.min(), each.max())])
    low, high = float(finite.min()), float(finite.max())
    y = np.full(finite.size, 0.5) if high == low else (finite - low) / (high - low)
    x = EDGE + np.arange(finite.size) / (finite.size - 1) * (WIDTH - 2 * EDGE)
    points = " ".join(f"{a:.1f},{HEIGHT - EDGE - b * (HEIGHT - 2 * EDGE):.1f}" for a, b in zip(x, y, strict=True))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'role="img" aria-label="from {low:.4g} to {high:.4g}"><polyline points="{points}" fill="none" '
        'stroke="#0072B2" stroke-width="1.5"/></svg>'
    )


def curve(shown: object, depth: int = DEEPEST) -> tuple[str, FloatArray] | None:
    """Return what an object's sparkline shows and its numbers `(n,)`: by `_as_curve`, else its first long array."""
    if (own := getattr(shown, "_as_curve", None)) is not None:
        return own()
    held = [(name, value) for name, value in attributes(shown) if name not in AXES]
    for name in (one for one in FIRST if depth and hasattr(shown, one)):
        if (inside := getattr(shown, name)) is not None and (found := curve(inside, depth - 1)):
            return f"{name}: {found[0]}", found[1]
    for name, value in held:
        if isinstance(value, np.ndarray):
            numbers = cast("np.ndarray[Any, Any]", value)
            if numbers.ndim and numbers.shape[-1] >= FEWEST and numbers.dtype.kind in "fci":
                return name, _row(numbers)
    for name, value in held:
        inside = list(cast("tuple[Any, ...]", value))[:1] if isinstance(value, tuple) else [value]
        for each in inside:
            if depth and hasattr(each, "__dataclass_fields__") and (found := curve(each, depth - 1)):
                return f"{name}: {found[0]}", found[1]
    return None


def _row(numbers: "np.ndarray[Any, Any]") -> FloatArray:
    """Return the first row; of complex gains the size in dB."""
    row = numbers.reshape(-1, numbers.shape[-1])[0]
    if np.iscomplexobj(row):
        row = 20.0 * np.log10(np.maximum(np.abs(row), np.finfo(float).tiny))
    return np.asarray(row, dtype=np.float64)
