"""The waterfall: how the spectrum of a reading moves in time, without the law and with it."""

from collections.abc import Mapping

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, HeatMap
from ultraquiet.plot.study import file_stem
from ultraquiet.values import Record
from ultraquiet.values.channel import squared

PERIODS = 4.0  # of the tone in one segment: its line is told from those beside it
COLUMNS, ROWS = 80, 120  # of the picture
DEPTH_DB = 70.0  # between the brightest and the darkest


def density_in_time(y: FloatArray, rate_hz: float, segment: int, columns: int) -> tuple[FloatArray, FloatArray]:
    """Return the middles of segments in seconds, and the one-sided density `(frequency, segment)` of each.

    P_k = 2 |DFT(w y)_k|^2 / (rate sum w^2), w a Hann window: the mean of P over the segments is Welch's.

    Args:
        y: one reading `(n,)`.
        rate_hz: its rate.
        segment: samples of one segment, at most n.
        columns: segments at most, spread evenly.
    """
    starts = np.unique(np.linspace(0, y.size - segment, min(columns, y.size - segment + 1)).astype(int))
    window = np.hanning(segment + 1)[:-1]
    parts = np.lib.stride_tricks.sliding_window_view(y, segment)[starts]
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power = 2 * np.abs(np.fft.rfft(parts, axis=1)) ** 2 / (rate_hz * np.sum(window**2))
    return (starts + segment / 2) / rate_hz, power.T


def waterfall(name: str, tone_hz: float, records: Mapping[str, Record], limits_hz: tuple[float, float]) -> Chart:
    """Return the spectrum over time of the reading that is loudest in the first record, in every record.

    Args:
        name: of the law.
        tone_hz: that is sent.
        records: runs of one bench by what they are, the open loop first; the colours are the same for all.
        limits_hz: frequencies that are shown.
    """
    first = next(iter(records.values()))
    k = int(np.argmax(np.std(first.outputs, axis=1)))
    channel, shortest = first.sensors[k], min(record.samples for record in records.values())
    segment = min(int(np.ceil(PERIODS * first.rate_hz / tone_hz)), shortest // 2)
    f = np.asarray(np.fft.rfftfreq(segment, 1.0 / first.rate_hz), dtype=np.float64)
    lines = _spread(f, limits_hz)
    found = {word: density_in_time(r.outputs[k], r.rate_hz, segment, COLUMNS) for word, r in records.items()}
    top = max(float(10 * np.log10(p[lines].max() + np.finfo(float).tiny)) for _, p in found.values())
    top = float(np.ceil(top))
    unit = f"{squared(channel.unit)}/Hz" if channel.unit else "1/Hz"
    panels, told = [], []
    for word, (t, power) in found.items():
        db = 10 * np.log10(np.maximum(power[lines], np.finfo(float).tiny))
        shown = HeatMap(f"density (dB re {unit})", t, f[lines], db, (top - DEPTH_DB, top))
        tone = Curve(f"tone, {tone_hz:g} Hz", t[[0, -1]], [tone_hz, tone_hz], "bad", ":", "path")
        panels.append(ChartPanel(Axis("time (s)"), Axis("frequency (Hz)", "log"), [tone], word, height=260, map=shown))
        at = int(np.argmin(np.abs(f - tone_hz)))
        half = power.shape[1] // 2
        told.append(f"{word} {10 * np.log10(power[at, half:].mean() + np.finfo(float).tiny):.0f} dB")
    caption = (
        f"{channel.name} while a tone of {tone_hz:g} Hz is sent, segments of {segment} samples, Hann, resolution "
        f"{1.5 * first.rate_hz / segment:.3g} Hz. At the tone, over the second half: {', '.join(told)}."
    )
    return Chart(file_stem(f"waterfall_{name}"), f"Waterfall, {name}", caption, panels, len(panels))


def _spread(f: FloatArray, limits_hz: tuple[float, float]) -> np.ndarray:
    """Return which lines are shown: within the limits, at most so many, even in the logarithm of frequency."""
    inside = np.flatnonzero((f >= max(limits_hz[0], f[1])) & (f <= limits_hz[1]))
    if inside.size < 2:
        inside = np.arange(1, f.size)
    if inside.size <= ROWS:
        return inside
    wanted = np.geomspace(f[inside[0]], f[inside[-1]], ROWS)
    return np.unique(inside[np.searchsorted(f[inside], wanted).clip(0, inside.size - 1)])
