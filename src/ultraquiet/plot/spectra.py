"""Spectra as figures: densities, responses, transmissibility, bands and criteria, each saying how it was averaged."""

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.spectra import CRITERIA, BandLevels, PowerSpectrum, Transmissibility
from ultraquiet.spectra.coherence import TRUSTED
from ultraquiet.spectra.criteria import UNITS_PER_METRE_PER_SECOND
from ultraquiet.values import Channel, FrequencyResponse
from ultraquiet.values.channel import per_root_hz, ratio

HZ = "frequency (Hz)"
# What stands for zero on an axis in dB.
FLOOR = 1e-300
LOWEST_DB = -120.0  # where an interval that reaches down to nothing ends
MARGIN_DB = 10.0
STYLES, COLOURS = ("-", "-.", ":"), 8  # of the palette: then another style of line begins
PANEL_IN = (4.0, 2.2)
SIGNATURE_WIDTH = 48


def density_figure(spectrum: PowerSpectrum, level: float = 0.95) -> Figure:
    """Amplitude spectral density of each channel with its confidence interval, and the rms that adds up below."""
    f = spectrum.f_hz > 0
    x = spectrum.f_hz[f]
    low, high = spectrum.interval(level)
    sides = ((low, f"{100 * level:g} % interval"), (high, ""))
    panels: list[Panel] = []
    for k, channel in enumerate(spectrum.channels):
        interval = [Line.of(x, _db(side[k, f]), label, ":", 7) for side, label in sides]
        lines = [*interval, Line.of(x, _db(spectrum.values[k, f]))]
        panels.append(Panel(lines, channel.name, HZ, f"dB re {per_root_hz(channel.unit)}", x_log=True))
        total = [Line.of(x, spectrum.cumulative_rms[k, f])]
        panels.append(Panel(total, f"{channel.name}: rms up to here", HZ, channel.unit, x_log=True))
    caption = f"Amplitude spectral densities and cumulative rms. {spectrum.estimator}."
    return Figure("density", "Spectral densities", caption, _signed(panels, spectrum.estimator), 2, _size(panels, 2))


def response_figure(response: FrequencyResponse) -> Figure:
    """Gain in dB with its standard error below it, phase, and coherence, of each output over all inputs.

    Where nothing is coherent the gain is noise, and the axis does not follow it. A coherence that all inputs share, the
    multiple one, is one curve.
    """
    x = response.f_hz
    panels: list[Panel] = []
    for i, sensor in enumerate(response.sensors):
        lines: list[Line] = []
        references = {_reference(sensor, actuator) for actuator in response.actuators}
        for j, actuator in enumerate(response.actuators):
            name = actuator.name if len(references) == 1 else f"{actuator.name} (re {_reference(sensor, actuator)})"
            lines.append(Line.of(x, _db(np.abs(response.values[i, j]) ** 2), name, shade=j))
            if response.variance is not None and np.isfinite(response.variance[i, j]).all():
                lines.append(Line.of(x, _db(response.variance[i, j]), style=":", shade=j))
        title = f"{sensor.name} (dotted: standard error)" if response.variance is not None else sensor.name
        span_db = _trusted_range(_db(np.abs(response.values[i]) ** 2), response.coherence, i)
        unit = f"dB re {references.pop()}" if len(references) == 1 else "dB"
        panels.append(Panel(lines, title, HZ, unit, x_log=True, y_range=span_db))
        phases = [Line.of(x, unwrapped_deg(g), shade=j) for j, g in enumerate(response.values[i])]
        panels.append(Panel(phases, f"{sensor.name}: phase", HZ, "degrees", x_log=True))
        if response.coherence is not None:
            coherences = _coherences(response, i)
            panels.append(Panel(coherences, f"{sensor.name}: coherence", HZ, x_log=True, y_range=(0.0, 1.05)))
    columns = 2 if response.coherence is None else 3
    signed, size = _signed(panels, response.estimator), _size(panels, columns)
    return Figure("response", "Frequency responses", f"{response.estimator}.", signed, columns, size)


def unwrapped_deg(gains: ComplexArray) -> FloatArray:
    """Return the phase in degrees without jumps, which begins between -180 and 180 degrees; a gap where nothing is.

    >>> unwrapped_deg(np.exp(-1j * np.arange(5.0) * 2.0)).round(1).tolist()
    [0.0, -114.6, -229.2, -343.8, -458.4]
    """
    phase, there = np.full(gains.size, np.nan), np.isfinite(gains) & (np.abs(gains) > 0)
    phase[there] = np.degrees(np.unwrap(np.angle(gains[there])))
    return phase


def _reference(sensor: Channel, actuator: Channel) -> str:
    """Return what a gain of 0 dB is."""
    return ratio(sensor.unit, actuator.unit)


def _coherences(response: FrequencyResponse, row: int) -> list[Line]:
    """Return one curve where all inputs share a coherence, else one an input."""
    assert response.coherence is not None
    shares = response.coherence[row]
    if (shares == shares[0]).all():
        return [Line.of(response.f_hz, shares[0])]
    named = enumerate(zip(shares, response.actuators, strict=True))
    return [Line.of(response.f_hz, share, actuator.name, shade=j) for j, (share, actuator) in named]


def transmissibility_figure(transmissibility: Transmissibility, level: float = 0.95) -> Figure:
    """Each payload direction over each base direction in dB with its interval; then the ratio of whole powers."""
    x = transmissibility.f_hz
    low, high = transmissibility.interval_db(level)
    panels: list[Panel] = []
    for i, payload in enumerate(transmissibility.response.sensors):
        for j, base in enumerate(transmissibility.response.actuators):
            interval = [Line.of(x, np.maximum(side[i, j], LOWEST_DB), style=":", shade=7) for side in (low, high)]
            lines = [*interval, Line.of(x, transmissibility.db[i, j])]
            span_db = _trusted_range(transmissibility.db[i], transmissibility.response.coherence, i)
            panels.append(Panel(lines, f"{base.name} to {payload.name}", HZ, "dB", x_log=True, y_range=span_db))
    panels.append(
        Panel([Line.of(x, transmissibility.overall_db)], "all directions: ratio of powers", HZ, "dB", x_log=True)
    )
    caption = f"Transmissibility with its {100 * level:g} % interval (dotted). {transmissibility.estimator}."
    columns = len(transmissibility.response.actuators)
    signed = _signed(panels, transmissibility.estimator)
    return Figure("transmissibility", "Base to payload", caption, signed, columns, _size(panels, columns))


def bands_figure(levels: BandLevels) -> Figure:
    """Levels in fractional octaves; velocities stand among the vibration criteria."""
    x = levels.bands.centre_hz
    velocity = all(c.unit in UNITS_PER_METRE_PER_SECOND for c in levels.channels)
    lines: list[Line] = []
    for k, channel in enumerate(levels.channels):
        scale = 1e6 / UNITS_PER_METRE_PER_SECOND[channel.unit] if velocity else 1.0
        style = STYLES[k // COLOURS % len(STYLES)]
        lines.append(Line.of(x, np.maximum(scale * levels.rms[k], FLOOR), channel.name, style, k))
    if velocity and levels.bands.fraction == 3:
        quietest = min(float(line.y.min()) for line in lines)
        # Criteria far below everything measured would only press the levels together.
        near = [one for one in CRITERIA if one.level_um_s > quietest]
        for k, one in enumerate(near):
            limit = 1e6 * one.limit_m_s(one.bands.centre_hz)
            lines.append(Line.of(one.bands.centre_hz, limit, one.name, "--", k))
    unit = "µm/s" if velocity else levels.channels[0].unit
    panel = Panel(lines, "", HZ, f"rms ({unit})", x_log=True, y_log=True)
    signed = _signed([panel], levels.estimator)
    return Figure("bands", f"1/{levels.bands.fraction} octaves", f"{levels.estimator}.", signed, 1, (8.0, 4.5))


def _db(power: FloatArray) -> FloatArray:
    return 10.0 * np.log10(np.maximum(power, FLOOR))


def _trusted_range(db: FloatArray, coherence: FloatArray | None, row: int) -> tuple[float, float] | None:
    """Return what `db` `(input, frequency)` spans where the output of that row is coherent, and a margin."""
    if coherence is None or not (trusted := (coherence[row] > TRUSTED) & np.isfinite(db)).any():
        return None
    coherent = db[trusted]
    return float(max(coherent.min(), LOWEST_DB)) - MARGIN_DB, float(coherent.max()) + MARGIN_DB


def _signed(panels: Sequence[Panel], estimator: str) -> list[Panel]:
    """Return the panels with the averaging printed below the last, so that no picture travels without it."""
    last = replace(panels[-1], x_label=f"{panels[-1].x_label}\n{textwrap.fill(estimator, SIGNATURE_WIDTH)}")
    return [*panels[:-1], last]


def _size(panels: Sequence[Panel], columns: int) -> tuple[float, float]:
    return PANEL_IN[0] * columns, PANEL_IN[1] * -(-len(panels) // columns)
