"""One law on drawn benches: how figures spread, what drives them, the loop of single cases."""

from collections.abc import Mapping

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark, decibel_axis, frequency_axis

BINS = 30


def spread_chart(figures: Mapping[str, Mapping[str, FloatArray]], asked: Mapping[str, float]) -> Chart:
    """Histograms of each figure over the drawn benches of each unit, in dB, and what is required of it."""
    panels: list[ChartPanel] = []
    told: list[str] = []
    for title, units in figures.items():
        shown = {unit: values[np.isfinite(values)] for unit, values in units.items()}
        edges = np.histogram_bin_edges(np.concatenate([*shown.values(), np.zeros(0)]), BINS)
        middle, width = (edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0])
        bars = [
            Curve(
                unit,
                middle,
                np.histogram(values, edges)[0],
                f"law-{k + 1}" if k else "chosen",
                "-",
                "bars",
                width=width,
            )
            for k, (unit, values) in enumerate(shown.items())
            if values.size
        ]
        told += [f"{title} on {u}: {v.min():.1f} to {v.max():.1f} dB" for u, v in shown.items() if v.size]
        marks = [Mark(f"asked: {asked[title]:g} dB", x=asked[title])] if title in asked else []
        panels.append(
            ChartPanel(Axis(f"{title} (dB)", ticks="dB"), Axis("benches (1)"), bars, "", (), marks, height=220)
        )
    return Chart("spread", "Drawn benches", f"{'; '.join(told)}.", panels, 2)


def drivers_chart(drivers: Mapping[str, Mapping[str, float]]) -> Chart:
    """Rank correlation of each figure with the parameters that were drawn."""
    panels = [
        ChartPanel(
            Axis("parameter", range=(-0.5, len(found) - 0.5), names=list(found)),
            Axis("rank correlation (1)", range=(-1.0, 1.0)),
            [Curve(title, np.arange(len(found), dtype=float), list(found.values()), "chosen", "-", "bars", width=0.6)],
            title,
            height=200,
        )
        for title, found in drivers.items()
    ]
    strongest = [f"{t}: {max(f, key=lambda n: abs(f[n]))}" for t, f in drivers.items()]
    return Chart("drivers", "What drives them", f"Strongest: {'; '.join(strongest)}.", panels, 1, legend="none")


def cases_chart(f_hz: FloatArray, cases: Mapping[str, FloatArray]) -> Chart:
    """Worst direction of S of single cases, in dB."""
    colours = ("open", "chosen")
    lines = [Curve(name, f_hz, db, colours[k % 2]) for k, (name, db) in enumerate(cases.items())]
    told = "; ".join(
        f"{name}: peak {db.max():.1f} dB at {f_hz[int(np.argmax(db))]:.3g} Hz" for name, db in cases.items()
    )
    panel = ChartPanel(frequency_axis(), decibel_axis("amplification"), lines, height=220)
    return Chart("cases", "Single cases, worst direction", f"{told}.", [panel])
