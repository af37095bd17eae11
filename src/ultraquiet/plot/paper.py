"""The paper's figures, redrawn from the study's own records and models."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.values import Record

HZ, SECONDS, VOLTS = "frequency (Hz)", "time (s)", "V"
Response = tuple[str, FloatArray, ComplexArray]


def test_signals(signals: Mapping[str, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]) -> Figure:
    """Fig. 6 and section 3.3: each test signal `(time_s, volts, f_hz, psd)` and its power spectral density."""
    panels: list[Panel] = []
    for k, (name, (t, v, f, psd)) in enumerate(signals.items()):
        panels.append(Panel([Line.of(t, v, shade=k)], name, SECONDS, VOLTS, y_range=(-27, 27)))
        db = 10 * np.log10(np.maximum(psd[1:], 1e-12))
        panels.append(Panel([Line.of(f[1:], db, shade=k)], f"{name}: spectrum", HZ, "dB re V²/Hz", x_log=True))
    caption = (
        "Test signals at the stack, limited to ±25 V, and their one-sided power spectral densities (paper: Fig. 6)."
    )
    return Figure("test_signals", "Test signals", caption, panels, 2, (8.0, 1.9 * len(signals)))


def responses_to_one_strut(record: Record, actuator: int) -> Figure:
    """Fig. 7: all six sensors while one actuator is driven."""
    scale = float(np.abs(record.outputs).max()) * 1.05
    panels = [
        Panel(
            [Line.of(record.time_s, y, shade=0 if i == actuator else 7)],
            c.name,
            SECONDS,
            VOLTS,
            y_range=(-scale, scale),
        )
        for i, (y, c) in enumerate(zip(record.outputs, record.sensors, strict=True))
    ]
    caption = f"Readings of all sensors to the chirp on {record.actuators[actuator].name} (paper: Fig. 7)."
    return Figure("responses", "Responses to one strut", caption, panels, 3, (8.0, 3.8))


def step_response(record: Record, simulated: Mapping[str, FloatArray], channel: int) -> Figure:
    """Figs. 8 and 9: the step, and the reading beside what models `(n,)` say."""
    t = record.time_s
    models = [Line.of(t, y, name, "--", k + 1) for k, (name, y) in enumerate(simulated.items())]
    panels = [
        Panel([Line.of(t, record.inputs[channel])], "command", SECONDS, VOLTS),
        Panel([Line.of(t, record.outputs[channel], "bench"), *models], "reading and simulations", SECONDS, VOLTS),
    ]
    caption = "Step on one strut; the geophone answers the edges only (paper: Figs. 8 and 9)."
    return Figure("step", "Step response", caption, panels, 1, (8.0, 4.2))


def sine_response(record: Record, simulated: Mapping[str, FloatArray], channel: int, shown_s: float = 0.2) -> Figure:
    """Fig. 10: a sine large enough to clip the sensor, and what linear models `(n,)` say."""
    n = int(shown_s * record.rate_hz)
    t = record.time_s[-n:]
    models = [Line.of(t, y[-n:], name, "-", k + 1) for k, (name, y) in enumerate(simulated.items())]
    lines = [*models, Line.of(t, record.outputs[channel, -n:], "bench, clipped at ±10 V", "--", 0)]
    caption = "A 60 Hz, 25 V sine: the bench clips at ±10 V, linear models do not (paper: Fig. 10)."
    return Figure("sine", "Response to a 60 Hz sine", caption, [Panel(lines, "", SECONDS, VOLTS)], 1, (8.0, 2.8))


def bode(responses: Sequence[Response], output: int, input_: int, span_hz: tuple[float, float]) -> Figure:
    """Fig. 11: one channel identified from different test signals."""
    styles = ("-", "--", "-.", ":", "-")
    magnitude = [
        Line.of(f, 20 * np.log10(np.abs(g[output, input_])), name, styles[k % 5], k)
        for k, (name, f, g) in enumerate(responses)
    ]
    phase = [
        Line.of(f, _phase_deg(f, g[output, input_]), "", styles[k % 5], k) for k, (_, f, g) in enumerate(responses)
    ]
    panels = [
        Panel(magnitude, "magnitude", "", "dB re V/V", True, span_hz),
        Panel(phase, "phase", HZ, "degrees", True, span_hz),
    ]
    caption = f"Strut {input_ + 1} to sensor {output + 1}: models from different test signals (paper: Fig. 11)."
    return Figure("bode", "Frequency-domain validation", caption, panels, 1, (8.0, 4.8))


def _phase_deg(f_hz: FloatArray, gain: ComplexArray, at_hz: float = 50.0) -> FloatArray:
    """Return the phase unwrapped from 50 Hz both ways, where every test signal has power, so that curves can meet."""
    phase = np.degrees(np.unwrap(np.angle(gain)))
    k = int(np.argmin(np.abs(f_hz - at_hz)))
    return phase - 360.0 * np.round(phase[k] / 360.0)


def bode_grid(responses: Sequence[Response], span_hz: tuple[float, float]) -> Figure:
    """All channels of the transfer matrix, magnitude."""
    ny, nu, _ = responses[0][2].shape
    panels = [
        Panel(
            [Line.of(f, 20 * np.log10(np.abs(g[i, j])), shade=k) for k, (_, f, g) in enumerate(responses)],
            f"{j + 1} → {i + 1}",
            x_log=True,
            x_range=span_hz,
            y_range=(-80, 20),
        )
        for i in range(ny)
        for j in range(nu)
    ]
    names = ", ".join(
        f"{name} ({colour})" for (name, _, _), colour in zip(responses, ("blue", "orange", "green"), strict=False)
    )
    caption = f"Magnitude in dB over Hz of every channel, actuator → sensor: {names}."
    return Figure("bode_grid", "The transfer matrix", caption, panels, nu, (11.0, 9.5))


def singular_values(f_hz: FloatArray, bands: Mapping[str, FloatArray]) -> Figure:
    """Fig. 12: singular values `(k, nf)` of each named model."""
    panels = [
        Panel([Line.of(f_hz, 20 * np.log10(s), shade=0) for s in values], name, HZ, "dB re V/V", x_log=True)
        for name, values in bands.items()
    ]
    caption = (
        "Singular values of the transfer matrix; the band is narrow where direction matters little (paper: Fig. 12)."
    )
    return Figure("singular_values", "Singular values", caption, panels, len(panels), (8.0, 3.0))


def closed_loop(name: str, tone_hz: float, record: Record, opened: Record) -> Figure:
    """Figs. 14 and 15: every sensor under a tone at the plant's input, loop open and closed."""
    panels = [
        Panel([Line.of(opened.time_s, o, shade=7), Line.of(record.time_s, c, shade=0)], channel.name, SECONDS, VOLTS)
        for channel, o, c in zip(record.sensors, opened.outputs, record.outputs, strict=True)
    ]
    caption = (
        f"{name}, {tone_hz:g} Hz, 1 V on all actuators: open (grey) and closed loop (blue) (paper: Figs. 14 and 15)."
    )
    stem = f"closed_loop_{name}_{tone_hz:g}hz".replace(" ", "_").replace("/", "-")
    return Figure(stem, f"Closed loop: {name} at {tone_hz:g} Hz", caption, panels, 3, (8.0, 3.6))


def sensitivity(curves: Mapping[str, tuple[FloatArray, FloatArray]], band_hz: tuple[float, float]) -> Figure:
    """Worst-direction reduction `(f_hz, reduction_db)` of each controller, measured on the bench."""
    lines = [Line.of(f, -r, name, shade=k) for k, (name, (f, r)) in enumerate(curves.items())]
    panel = Panel(lines, "", HZ, "amplification (dB)", True, spans=[band_hz])
    caption = "Largest singular value of the sensitivity measured on the bench: below zero, every direction is quieter."
    return Figure("sensitivity", "Every direction, every frequency", caption, [panel], 1, (8.0, 3.8))
