"""The figures of a study, drawn from its own records and models: names, units and levels are those of its bench.

`note` closes a caption: where a publication shows the same, it says where.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.spectra import psd
from ultraquiet.values import Channel, Record
from ultraquiet.values.channel import ratio, squared

HZ, SECONDS = "frequency (Hz)", "time (s)"
Response = tuple[str, FloatArray, ComplexArray]
Wires = tuple[Sequence[Channel], Sequence[Channel]]  # actuators, sensors
# A command with this share of its power at one frequency is a tone, of which so many periods are shown.
ONE_TONE, SHOWN_PERIODS = 0.9, 12.0
MEASURED = 6  # of the palette: what a bench said is black wherever models stand beside it


def excitation_signals(signals: Mapping[str, tuple[Record, int]], note: str = "") -> Figure:
    """Each test signal, the record that sent it and by which actuator, beside its power spectral density."""
    panels: list[Panel] = []
    for k, (name, (record, actuator)) in enumerate(signals.items()):
        unit = record.actuators[actuator].unit
        power = psd(record.inputs[actuator], record.rate_hz)
        f, values = power.f_hz[1:], power.values.ravel()[1:]
        panels.append(
            Panel([Line.of(record.time_s, record.inputs[actuator], shade=k)], name, SECONDS, _labelled("command", unit))
        )
        db = 10 * np.log10(np.maximum(values, values.max(initial=0.0) * 1e-12 + np.finfo(float).tiny))
        panels.append(
            Panel([Line.of(f, db, shade=k)], f"{name}: spectrum", HZ, f"density (dB re {squared(unit)}/Hz)", x_log=True)
        )
    caption = f"Test signals as they were sent, and their one-sided power spectral densities.{note}"
    return Figure("test_signals", "Test signals", caption, panels, 2, (8.0, 1.9 * len(signals)))


def responses(name: str, record: Record, actuator: int, note: str = "") -> Figure:
    """All sensors while one actuator is driven, its own in colour; of several at once none is another's."""
    driven, verb = _driven(record, actuator)
    panels = [
        Panel(
            [Line.of(record.time_s, y, shade=0 if i == actuator or verb == "send" else 7)],
            c.name,
            SECONDS,
            _labelled("reading", c.unit),
        )
        for i, (y, c) in enumerate(zip(record.outputs, record.sensors, strict=True))
    ]
    caption = f"Readings of all sensors while {driven} {verb} '{name}'.{note}"
    rows = -(-len(panels) // 3)
    return Figure("responses", f"Responses to {driven}", caption, panels, 3, (8.0, 1.9 * rows))


def _driven(record: Record, actuator: int) -> tuple[str, str]:
    """Return who moves in a record, and the verb: one actuator by its name, or how many at once."""
    moving = int(np.count_nonzero(np.ptp(record.inputs, axis=1)))
    if moving <= 1:
        return record.actuators[actuator].name, "sends"
    return (f"all {moving} actuators" if moving == len(record.inputs) else f"{moving} actuators at once"), "send"


def simulation(
    name: str, record: Record, simulated: Mapping[str, FloatArray], actuator: int, sensor: int, note: str = ""
) -> Figure:
    """A record, and what models `(n,)` say to its command, at one sensor; a strong tone in its last periods alone."""
    n = _shown(record.inputs[actuator])
    t, y = record.time_s[-n:], record.outputs[sensor, -n:]
    command, reading = record.actuators[actuator], record.sensors[sensor]
    models = [Line.of(t, values[-n:], model, "--", k) for k, (model, values) in enumerate(simulated.items())]
    panels = [
        Panel([Line.of(t, record.inputs[actuator, -n:])], command.name, SECONDS, _labelled("command", command.unit)),
        Panel(
            [Line.of(t, y, "bench", shade=MEASURED), *models],
            f"{reading.name}, as read and as simulated",
            SECONDS,
            _labelled("reading", reading.unit),
        ),
    ]
    clipped = record.clipped()[sensor]
    limits = (
        f" The bench clips at {reading.low:g} and {reading.in_unit(reading.high)}, models do not." if clipped else ""
    )
    driven, _ = _driven(record, actuator)
    shown = "" if driven == command.name else f", {command.name} shown"
    caption = f"'{name}' on {driven}{shown}, and what models say of it.{limits}{note}"
    return Figure(file_stem(name), f"Response to '{name}'", caption, panels, 1, (8.0, 4.2))


def _shown(command: FloatArray) -> int:
    """Return how many samples are shown, from the end: all, or the last periods of what is one tone."""
    power = np.abs(np.fft.rfft((command - command.mean()) * np.hanning(command.size))) ** 2
    peak = int(np.argmax(power))
    around = power[max(peak - 2, 0) : peak + 3].sum()
    if peak < 2 * SHOWN_PERIODS or around < ONE_TONE * power.sum():
        return command.size
    return int(SHOWN_PERIODS * command.size / peak)


def bode(
    models: Sequence[Response], wires: Wires, output: int, input_: int, span_hz: tuple[float, float], note: str = ""
) -> Figure:
    """One channel as several models have it."""
    styles = ("-", "--", "-.", ":", "-")
    magnitude = [
        Line.of(f, decibels(g[output, input_]), name, styles[k % 5], k) for k, (name, f, g) in enumerate(models)
    ]
    middle = float(np.sqrt(span_hz[0] * span_hz[1]))
    phase = [
        Line.of(f, _phase_deg(f, g[output, input_], middle), "", styles[k % 5], k) for k, (_, f, g) in enumerate(models)
    ]
    panels = [
        Panel(magnitude, "magnitude", HZ, f"gain ({gain_unit(wires)})", True, span_hz),
        Panel(phase, "phase", HZ, "phase (°)", True, span_hz),
    ]
    actuator, sensor = wires[0][input_].name, wires[1][output].name
    caption = f"From {actuator} to {sensor}: models from different test signals.{note}"
    return Figure("bode", "Frequency-domain validation", caption, panels, 1, (8.0, 4.8))


def _phase_deg(f_hz: FloatArray, gain: ComplexArray, at_hz: float) -> FloatArray:
    """Return the phase unwrapped from the middle of the span both ways, so that curves can meet."""
    phase = np.degrees(np.unwrap(np.angle(gain)))
    k = int(np.argmin(np.abs(f_hz - at_hz)))
    return phase - 360.0 * np.round(phase[k] / 360.0)


def _labelled(what: str, unit: str) -> str:
    """Return the label of an axis, its unit in brackets where there is one."""
    return f"{what} ({unit})" if unit else what


def file_stem(name: str) -> str:
    """Return a name as that of a file."""
    return name.replace(" ", "_").replace("/", "-")


def gain_unit(wires: Wires) -> str:
    """Return the reference of a gain in decibels; without one where channels have different units."""
    actuators, sensors = ({c.unit for c in channels} for channels in wires)
    if len(actuators) > 1 or len(sensors) > 1:
        return "dB"
    sensor, actuator = next(iter(sensors), ""), next(iter(actuators), "")
    return f"dB re {ratio(sensor, actuator)}" if sensor or actuator else "dB"


def decibels(gain: ComplexArray | FloatArray) -> FloatArray:
    """Return 20 log10 |gain|, of zero a very low number."""
    return 20 * np.log10(np.maximum(np.abs(gain), 1e-300))
