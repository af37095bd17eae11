"""Records over time, and what cannot be seen at one pixel a sample."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve, Mark, Region

HEIGHT = 132


def envelope(signals: FloatArray, columns: int = 800) -> tuple[FloatArray, FloatArray]:
    """Return the places and values that keep the smallest and the largest sample of every bin.

    Args:
        signals: `(channel, sample)`.
        columns: bins.

    Returns:
        Sample numbers `(2 columns,)` and values `(channel, 2 columns)`; all samples where there are no more.

    >>> envelope(np.arange(6.0)[None], 2)[1].tolist()
    [[0.0, 2.0, 3.0, 5.0]]
    """
    n = signals.shape[1]
    if n <= 2 * columns:
        return np.arange(n, dtype=float), signals
    edges = np.linspace(0, n, columns + 1).astype(int)
    low = np.minimum.reduceat(signals, edges[:-1], axis=1)
    high = np.maximum.reduceat(signals, edges[:-1], axis=1)
    rising = np.argmax(signals[:, : edges[1]], axis=1) >= np.argmin(signals[:, : edges[1]], axis=1)
    first, second = np.where(rising[:, None], low, high), np.where(rising[:, None], high, low)
    middle = (edges[:-1] + edges[1:]) / 2
    width = np.diff(edges) / 4
    places = np.column_stack([middle - width, middle + width]).ravel()
    return places, np.stack([first, second], axis=2).reshape(len(signals), -1)


def traces(
    title: str,
    time_s: FloatArray,
    signals: FloatArray,
    channels: Sequence[tuple[str, str]],
    inputs: int,
    parts: Mapping[str, tuple[float, float]] | None = None,
) -> Chart:
    """Return one panel a channel, inputs first; `parts` are named stretches in seconds."""
    regions = [Region(name, (low, high)) for name, (low, high) in (parts or {}).items()]
    panels = [
        ChartPanel(
            Axis("time (s)"),
            Axis(unit or "value"),
            [Curve("command" if k < inputs else "reading", time_s, row, "open" if k < inputs else "measured")],
            title=f"{'input' if k < inputs else 'output'}: {name}",
            regions=regions,
            height=HEIGHT,
        )
        for k, (row, (name, unit)) in enumerate(zip(signals, channels, strict=True))
    ]
    columns = 1 if len(panels) <= 4 else 2
    return Chart("record", title, "", panels, columns=columns, legend="below")


def overlay(
    title: str,
    caption: str,
    time_s: FloatArray,
    measured: FloatArray,
    said: Mapping[str, FloatArray],
    channels: Sequence[tuple[str, str]],
    colours: Mapping[str, str],
) -> Chart:
    """Return measured outputs with what models say to the same inputs, one panel an output."""
    panels = [
        ChartPanel(
            Axis("time (s)"),
            Axis(f"{name} ({unit})" if unit else name),
            [
                Curve("measured", time_s, measured[k]),
                *(Curve(model, time_s, rows[k], colours[model]) for model, rows in said.items()),
            ],
            title=name,
            height=176,
        )
        for k, (name, unit) in enumerate(channels)
    ]
    return Chart("simulated", title, caption, panels, columns=1 if len(panels) < 3 else 2)


LEFT = (
    "Of what was read less what was simulated: disturbances stay in it, so bars with itself may stand beyond the "
    "dashed bounds of a good model; bars with the inputs that do are what the model left."
)


def correlations(title: str, auto: FloatArray, cross: FloatArray, bound: float, names: Sequence[str]) -> Chart:
    """Return what is left after a model, by lag, with its 99 % bounds: correlation with its past and with the inputs.

    Lag 0 of a residual with itself is one whatever the model is, and would hide the others; of all inputs the largest
    size is shown, which has no lower bound.
    """
    lags = np.arange(auto.shape[1], dtype=float)
    above, below = (Mark("99 % bound", y=end * bound, colour="fragile") for end in (1, -1))
    panels = []
    for k, name in enumerate(names):
        sides = ("with itself", auto, 1, [above, below]), ("with the inputs, largest", cross, 0, [above])
        for word, rows, first, marks in sides:
            curve = Curve(word, lags[first:], rows[k, first:], "measured", kind="stems")
            axes = Axis("lag (samples)"), Axis("correlation (1)")
            panels.append(ChartPanel(*axes, [curve], title=f"residual of {name} {word}", marks=marks, height=150))
    return Chart("residuals", title, LEFT, panels, columns=2)
