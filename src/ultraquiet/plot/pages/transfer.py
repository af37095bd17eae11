"""The measured transfer matrix with its confidence against models, channel by channel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.shown.line import counted
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, decibel_axis, frequency_axis
from ultraquiet.plot.study import Wires, decibels, gain_unit
from ultraquiet.values import FrequencyResponse

MOST_LINES = 240  # of a channel: more than its panel has pixels
FAINTEST_DB = 120.0  # below the largest gain of the matrix: what is fainter is not drawn
# A complex normal error of variance v exceeds sqrt(v ln 20) in one of twenty cases.
RADIUS_95 = float(np.sqrt(np.log(20.0)))
PHASE = Axis("phase (°)", ticks="deg")


@dataclass(frozen=True, eq=False)
class NamedResponse:
    """What a model says at the lines that are drawn: gains `(ny, nu, nf)` and the word for its colour."""

    name: str
    values: ComplexArray
    colour: str


def shown_lines(f_hz: FloatArray, span_hz: tuple[float, float]) -> np.ndarray:
    """Return which of the lines are drawn: evenly spread over the logarithm of frequency, at most `MOST_LINES`.

    >>> shown_lines(np.arange(1.0, 7.0), (2.0, 5.0)).tolist()
    [1, 2, 3, 4]
    """
    inside = np.flatnonzero((f_hz >= span_hz[0]) & (f_hz <= span_hz[1]))
    if inside.size <= MOST_LINES:
        return inside
    wanted = np.geomspace(f_hz[inside[0]], f_hz[inside[-1]], MOST_LINES)
    return np.unique(inside[np.searchsorted(f_hz[inside], wanted).clip(0, inside.size - 1)])


def transfer_grid(
    f_hz: FloatArray, measured: FrequencyResponse | None, models: Sequence[NamedResponse], wires: Wires
) -> Chart:
    """All channels over shared axes, each with its phase and its error to be enlarged.

    Args:
        f_hz: lines at which everything is given, `(nf,)`.
        measured: the response that was measured there, with its variance; None where there is none.
        models: what is compared with it; the first one's error is told in the caption.
        wires: actuators and sensors, in the order of the matrix.
    """
    actuators, sensors = wires
    limits = _limits([*([] if measured is None else [measured.values]), *(m.values for m in models)])
    gain = decibel_axis("gain", gain_unit(wires).removeprefix("dB").removeprefix(" re "), limits)
    panels = [
        _channel(f_hz, measured, models, (i, j), gain, f"{actuator.name} → {sensor.name}")
        for i, sensor in enumerate(sensors)
        for j, actuator in enumerate(actuators)
    ]
    one = len(panels) == 1
    if one:
        panels = [panels[0], *panels[0].detail]
    caption = _caption(f_hz, measured, models, one)
    columns = 1 if one else len(actuators)
    return Chart("response", "Response, actuator → sensor", caption, panels, columns, not one, not one)


def _channel(
    f_hz: FloatArray,
    measured: FrequencyResponse | None,
    models: Sequence[NamedResponse],
    at: tuple[int, int],
    gain: Axis,
    title: str,
) -> ChartPanel:
    x = frequency_axis(float(f_hz[0]), float(f_hz[-1]))
    over, phases, errors = list[Curve](), list[Curve](), list[Curve]()
    if measured is not None:
        values = measured.values[at]
        over.append(_with_confidence(f_hz, values, None if measured.variance is None else measured.variance[at]))
        phases.append(Curve("measured", f_hz, _phase_deg(values)))
    for model in models:
        over.append(Curve(model.name, f_hz, decibels(model.values[at]), model.colour))
        phases.append(Curve(model.name, f_hz, _phase_deg(model.values[at]), model.colour))
        if measured is not None:
            errors.append(Curve(model.name, f_hz, decibels(model.values[at] - measured.values[at]), model.colour))
    if measured is not None and measured.variance is not None and np.isfinite(measured.variance[at]).all():
        errors.append(Curve("measured", f_hz, decibels(RADIUS_95 * np.sqrt(measured.variance[at])), "measured", ":"))
    detail = [ChartPanel(x, PHASE, phases, height=180)]
    if errors:
        detail.append(ChartPanel(x, Axis(gain.label.replace("gain", "error", 1), ticks="dB"), errors, height=180))
    return ChartPanel(x, gain, over, title, tinted=at[0] == at[1], detail=detail)


def _with_confidence(f_hz: FloatArray, values: ComplexArray, variance: FloatArray | None) -> Curve:
    if variance is None or not np.isfinite(variance).all():
        return Curve("measured", f_hz, decibels(values))
    size, radius = np.abs(values), RADIUS_95 * np.sqrt(variance)
    low = np.maximum(size - radius, 0.05 * size)  # an interval that reaches down to nothing ends 26 dB below
    return Curve("measured", f_hz, decibels(values), low=decibels(low), high=decibels(size + radius))


def _caption(f_hz: FloatArray, measured: FrequencyResponse | None, models: Sequence[NamedResponse], one: bool) -> str:
    more = "phase" if measured is None else "phase and its error"
    enlarge = "" if one else f" A click on a panel shows its {more}."
    lines = f"{counted(f_hz.size, 'line')} from {f_hz[0]:.3g} to {f_hz[-1]:.3g} Hz."
    if measured is None:
        return f"{' and '.join(m.name for m in models)}: gain of every channel, {lines}{enlarge}"
    worst = [
        f"{model.name} lies within {20 * np.log10(1 + _share(model.values, measured.values)):.2g} dB of half of them"
        for model in models[:1]
    ]
    sure = " with the interval that holds 95 % of what noise does" if measured.variance is not None else ""
    return f"Measured{sure}, and models; {lines} {'; '.join(worst)}.{enlarge}"


@np.errstate(over="ignore")  # over nothing at all
def _share(model: ComplexArray, measured: ComplexArray) -> float:
    return float(np.median(np.abs(model - measured) / np.maximum(np.abs(measured), np.finfo(float).tiny)))


def _limits(all_values: Sequence[ComplexArray]) -> tuple[float, float]:
    db = [decibels(values) for values in all_values]
    top = max(float(v.max()) for v in db)
    low = max(min(float(v.min()) for v in db), top - FAINTEST_DB)
    room = 0.05 * max(top - low, 1.0)
    return low - room, top + room


def _phase_deg(values: ComplexArray) -> FloatArray:
    """Return the phase unwrapped from the lowest line, which lies between -180 and 180 degrees."""
    phase = np.degrees(np.unwrap(np.angle(values)))
    return phase - 360.0 * np.round(phase[0] / 360.0)
