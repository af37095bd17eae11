"""What the bench showed with the loop open and closed: time histories, densities and the rms that adds up below."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import loudness
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, decibel_axis, frequency_axis
from ultraquiet.plot.study import file_stem
from ultraquiet.spectra import psd
from ultraquiet.values import Record
from ultraquiet.values.channel import per_root_hz

PERIODS = 12  # of a tone that are drawn, from the end
UP_TO_HERE = "rms of what lies below each frequency"


def under_tone(name: str, tone_hz: float, sent: str, closed: Record, opened: Record, note: str = "") -> Chart:
    """Every sensor under a tone at the plant's input, loop open and closed, in its last periods."""
    n = min(closed.samples, int(np.ceil(PERIODS * closed.rate_hz / tone_hz)))
    t = closed.time_s[-n:]
    panels = [
        ChartPanel(
            Axis("time (s)"),
            Axis(f"reading ({channel.unit})" if channel.unit else "reading"),
            [Curve("open loop", t, o[-n:], "open"), Curve("closed loop", t, c[-n:], "chosen")],
            channel.name,
            height=150,
        )
        for channel, o, c in zip(closed.sensors, opened.outputs, closed.outputs, strict=True)
    ]
    quieter = 20 * np.log10(_rms(opened.outputs[:, -n:]) / _rms(closed.outputs[:, -n:]))
    k = int(np.argmin(quieter))
    caption = (
        f"{name}: a tone of {tone_hz:g} Hz, {sent} on all actuators, its last {PERIODS} periods with sensor noise. The "
        f"reading that gains least, {closed.sensors[k].name}, becomes {loudness(quieter[k])} (rms).{note}"
    )
    stem = file_stem(f"closed_loop_{name}_{tone_hz:g}hz")
    return Chart(stem, f"{name} at {tone_hz:g} Hz", caption, panels, min(3, len(panels)))


def _rms(signals: FloatArray) -> FloatArray:
    return np.sqrt(np.mean((signals - signals.mean(axis=1, keepdims=True)) ** 2, axis=1)) + np.finfo(float).tiny


def densities(name: str, tone_hz: float, closed: Record, opened: Record) -> Chart:
    """Amplitude spectral density of the loudest sensor, loop open and closed, and the rms up to each frequency."""
    k = int(np.argmax(_rms(opened.outputs)))
    channel = closed.sensors[k]
    spectra = {
        "open loop": psd(opened.outputs[k], opened.rate_hz),
        "closed loop": psd(closed.outputs[k], closed.rate_hz),
    }
    colours = {"open loop": "open", "closed loop": "chosen"}
    density, total = list[Curve](), list[Curve]()
    for label, spectrum in spectra.items():
        f, values = spectrum.f_hz[1:], spectrum.values.ravel()[1:]
        rms = np.sqrt(np.cumsum(values) * (f[1] - f[0]))
        floor = np.finfo(float).tiny
        density.append(Curve(label, f, 10 * np.log10(np.maximum(values, floor)), colours[label]))
        total.append(Curve(label, f, rms, colours[label]))
    ends = [float(np.asarray(curve.y)[-1]) for curve in total]
    unit = channel.unit
    panels = [
        ChartPanel(frequency_axis(), decibel_axis("density", per_root_hz(unit)), density, height=220),
        ChartPanel(frequency_axis(), Axis(f"rms ({unit})" if unit else "rms"), total, UP_TO_HERE, height=160),
    ]
    caption = (
        f"Reading of {channel.name} under the tone of {tone_hz:g} Hz: {channel.in_unit(ends[0], 3)} rms open, "
        f"{channel.in_unit(ends[1], 3)} closed. {spectra['open loop'].estimator}."
    )
    return Chart(file_stem(f"density_{name}"), f"Densities, {name}", caption, panels)
