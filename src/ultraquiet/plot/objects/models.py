"""Values as figures: records, responses, models with what is known of their confidence."""

from typing import Any

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import draws
from ultraquiet._base.shown.grid import shown_frequencies
from ultraquiet._base.shown.line import counted
from ultraquiet.identify import MatrixResult, ResponseFit, Result, WeightedFit
from ultraquiet.plot.figure import Figure, Fill, Line, Panel
from ultraquiet.plot.spectra import HZ, response_figure
from ultraquiet.validate import ResponseBand, response_band
from ultraquiet.values import (
    FrequencyResponse,
    PolynomialMatrix,
    PolynomialModel,
    Record,
    StateSpace,
    SteppedController,
)
from ultraquiet.values.channel import Channel, ratio

SECONDS = "time (s)"
MOST_ROWS = 8  # channels of one record
WIDE_IN, PANEL_IN, EACH_IN = (8.0, 1.7), (4.0, 2.2), 2.2
LEVEL = 0.95


@draws(Record)
def record_figure(record: Record) -> Figure:
    """What was sent and what was read over time, a panel a channel."""
    sent = [(c, row, 7) for c, row in zip(record.actuators, record.inputs, strict=True)]
    read = [(c, row, 0) for c, row in zip(record.sensors, record.outputs, strict=True)]
    shown = [*sent[:MOST_ROWS], *read[:MOST_ROWS]]
    panels = [Panel([Line.of(record.time_s, row, shade=shade)], c.name, SECONDS, c.unit) for c, row, shade in shown]
    left = len(sent) + len(read) - len(shown)
    caption = (
        f"{counted(record.samples, 'sample')} at {record.rate_hz:g} Hz"
        + f"; {counted(left, 'channel is', 'channels are')} not shown." * bool(left)
    )
    return Figure("record", "Record", caption, panels, 1, (WIDE_IN[0], WIDE_IN[1] * len(panels)))


@draws(FrequencyResponse)
def measured_figure(response: FrequencyResponse) -> Figure:
    """Gain with its standard error, phase and coherence."""
    return response_figure(response)


@draws(StateSpace, PolynomialModel, PolynomialMatrix)
def model_figure(model: Any) -> Figure:
    """Gain and phase of a model from every input to every output."""
    f_hz = shown_frequencies(model)
    values = model.frequency_response(f_hz)
    wires = {name: getattr(model, name, None) for name in ("actuators", "sensors")}
    return response_figure(FrequencyResponse(f_hz, values, estimator="from the model", **wires))


@draws(SteppedController)
def stepped_figure(controller: SteppedController) -> Figure:
    """The law that is stepped."""
    return model_figure(controller.law)


@draws(Result, MatrixResult)
def identified_figure(result: Any) -> Figure:
    """The model's response; where its confidence at each line is known, that besides."""
    model = result.model
    f_hz = shown_frequencies(model)
    if not isinstance(model, PolynomialMatrix) and getattr(result, "spread", None) is None:
        return model_figure(model)
    try:
        band = response_band(result, f_hz[f_hz < model.rate_hz / 2], LEVEL)
    except InputError:  # it knows no band
        return model_figure(model)
    return filled_figure(band, model.actuators, model.sensors)


@draws(ResponseFit, WeightedFit)
def fitted_figure(result: Any) -> Figure:
    """The fitted model's response."""
    return model_figure(result.model)


@draws(ResponseBand)
def band_figure(band: ResponseBand) -> Figure:
    """Gain and phase of each channel within their band."""
    ny, nu = band.values.shape[:2]
    inputs = tuple(Channel(f"input {j + 1}", "") for j in range(nu))
    return filled_figure(band, inputs, tuple(Channel(f"output {i + 1}", "") for i in range(ny)))


def filled_figure(band: ResponseBand, inputs: tuple[Channel, ...], outputs: tuple[Channel, ...]) -> Figure:
    """Gain and phase of each channel with what holds the truth with the stated probability at each line."""
    panels: list[Panel] = []
    label = f"{100 * band.level:g} % confidence"
    for i, j in np.ndindex(*band.values.shape[:2]):
        gain = f"dB re {ratio(outputs[i].unit, inputs[j].unit)}" if outputs[i].unit or inputs[j].unit else "dB"
        for middle, low, high, unit in (
            (band.gain_db, band.gain_low_db, band.gain_high_db, gain),
            (band.phase_deg, band.phase_low_deg, band.phase_high_deg, "degrees"),
        ):
            fill = Fill(band.f_hz, low[i, j], high[i, j], label)
            title = f"{inputs[j].name} to {outputs[i].name}"
            panels.append(Panel([Line.of(band.f_hz, middle[i, j])], title, HZ, unit, x_log=True, fills=[fill]))
    caption = f"Response with its {label} at each line, {band.method}."
    return Figure("bands", "Identified response", caption, panels, 2, (8.0, EACH_IN * len(panels) / 2))
