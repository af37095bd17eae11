"""What models are made of: orders and their errors, structures and their fits, poles and zeros, singular values."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark, decibel_axis, frequency_axis
from ultraquiet.plot.study import Wires, gain_unit


def errors_by_order(errors: Mapping[int, float], chosen: int) -> Chart:
    """Relative error at held-out lines over the order, and the order that was taken."""
    orders = np.array(sorted(errors), dtype=float)
    db = np.array([20 * np.log10(max(errors[int(n)], 1e-12)) for n in orders])
    curves = [
        Curve("held-out lines", orders, db, "chosen", symbol="."),
        Curve("order taken", [float(chosen)], [20 * np.log10(max(errors[chosen], 1e-12))], "bad", kind="points"),
    ]
    panel = ChartPanel(Axis("order", ticks="int"), decibel_axis("relative error"), curves, height=220)
    caption = (
        f"Error of the model at lines that it was not fitted to, by order: order {chosen} meets them within "
        f"{100 * errors[chosen]:.2g} %."
    )
    return Chart("orders", "Choice of the order", caption, [panel])


def criterion_by_order(scores: Mapping[int, float], chosen: int, criterion: str) -> Chart:
    """Criterion less its least, in its own unit (twice a log-likelihood), over the order; the order that was taken."""
    name, orders = criterion.upper(), sorted(scores)
    curves = [
        Curve(name, [float(n) for n in orders], [scores[n] for n in orders], "chosen", symbol="."),
        Curve("order taken", [float(chosen)], [scores[chosen]], "bad", kind="points"),
    ]
    panel = ChartPanel(Axis("order", ticks="int"), Axis(f"{name} above its least (1)"), curves, height=220)
    other = min((n for n in orders if n != chosen), key=lambda n: scores[n])
    caption = (
        f"{name} by order, less its least: what the fit misses of the lines against the number of its parameters. It "
        f"chose order {chosen}; the next best is order {other}, {scores[other]:.3g} above. No line is held out."
    )
    return Chart("orders", "Choice of the order", caption, [panel])


def fits_by_order(fits: Mapping[str, Sequence[tuple[int, float, float]]]) -> Chart:
    """Median and worst fit in % of every structure over its order, on records no model has seen."""
    panels: list[ChartPanel] = []
    for k, what in enumerate(("median fit (%)", "worst fit (%)")):
        curves = [
            Curve(
                name,
                [row[0] for row in sorted(rows)],
                [row[k + 1] for row in sorted(rows)],
                f"law-{n % 8 + 1}",
                symbol=".",
            )
            for n, (name, rows) in enumerate(sorted(fits.items()))
        ]
        panels.append(ChartPanel(Axis("order", ticks="int"), Axis(what), curves, height=200))
    name, (order, median, worst) = max(
        ((name, row) for name, rows in fits.items() for row in rows), key=lambda item: item[1][1]
    )
    caption = (
        f"One model a channel, judged on held-out records: {name} of order {order} has the best median, "
        f"{median:.1f} %, and simulates its worst channel by {worst:.1f} %."
    )
    return Chart("structures", "Structures and orders, channel by channel", caption, panels, 2)


def poles_and_zeros(
    poles: Sequence[tuple[float, float]], zeros: Sequence[tuple[float, float]], limits_hz: tuple[float, float]
) -> Chart:
    """Frequency in Hz and damping of the poles, and of the zeros: below zero those outside the unit circle."""
    curves = [
        Curve(name, [f for f, _ in found], [z for _, z in found], colour, kind="points", symbol=symbol)
        for name, roots, colour, symbol in (("poles", poles, "chosen", "x"), ("zeros", zeros, "law-1", "o"))
        if (found := [(f, z) for f, z in roots if limits_hz[0] <= f <= limits_hz[1]])
    ]
    marks = [Mark("edge of stability", y=0.0)]
    panel = ChartPanel(frequency_axis(*limits_hz), Axis("damping (1)"), curves, "", (), marks, height=260)
    outside = sum(z < 0 for _, z in zeros)
    many = f"{outside or 'none'} of the zeros {'lies' if outside == 1 else 'lie'} outside the unit circle"
    span = f"of the design plant from {limits_hz[0]:.2g} to {limits_hz[1]:.4g} Hz, conjugates counted once"
    caption = f"Poles and transmission zeros {span}; {many}." if zeros else f"Poles {span}; it has no zeros."
    return Chart("roots", "Poles and zeros", caption, [panel])


def singular_value_chart(f_hz: FloatArray, bands: Mapping[str, FloatArray], wires: Wires, note: str = "") -> Chart:
    """Singular values `(k, nf)` of each named model."""
    unit = gain_unit(wires).removeprefix("dB").removeprefix(" re ")
    colours = ("chosen", "law-1", "law-2")
    curves = [
        Curve(name, f_hz, 20 * np.log10(np.maximum(s, 1e-300)), colours[k % 3])
        for k, (name, values) in enumerate(bands.items())
        for s in values
    ]
    first = next(iter(bands.values()))
    spread = 20 * np.log10(np.maximum(first[0], 1e-300) / np.maximum(first[-1], 1e-300))
    k = int(np.argmax(spread))
    many = first.shape[0] > 1
    told = f" The directions lie furthest apart, {spread[k]:.0f} dB, at {f_hz[k]:.4g} Hz." if many else ""
    panel = ChartPanel(frequency_axis(), decibel_axis("gain", unit), curves, height=260)
    caption = f"Gain of every direction of the transfer matrix.{told}{note}"
    return Chart("singular_values", "Singular values", caption, [panel])
