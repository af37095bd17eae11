"""Evidence on models as figures: responses with their confidence, residual correlations, uncertainty and its weight."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.validate import ResidualTest, ResponseBand, UncertaintyWeight

HZ = "frequency (Hz)"
PANEL_IN = (4.0, 2.2)
FLOOR = 1e-300
GREY = 7


def band_figure(band: ResponseBand) -> Figure:
    """Gain and phase of each channel with the band that holds the truth with the stated probability at each line."""
    panels: list[Panel] = []
    for i, j in np.ndindex(*band.values.shape[:2]):
        for middle, low, high, unit in (
            (band.gain_db, band.gain_low_db, band.gain_high_db, "dB"),
            (band.phase_deg, band.phase_low_deg, band.phase_high_deg, "degrees"),
        ):
            sides = [Line.of(band.f_hz, x[i, j], style=":", shade=GREY) for x in (low, high)]
            lines = [*sides, Line.of(band.f_hz, middle[i, j])]
            panels.append(Panel(lines, f"input {j + 1} to output {i + 1}", HZ, unit, x_log=True))
    caption = f"Response with its {100 * band.level:g} % confidence at each line (dotted), {band.method}."
    return Figure("bands", "Confidence of the response", caption, panels, 2, _size(panels, 2))


def residual_figure(test: ResidualTest) -> Figure:
    """Autocorrelation of each output's residual within the band of white noise, with the p-values."""
    lags = np.arange(1.0, test.autocorrelation.shape[1] + 1)
    panels: list[Panel] = []
    for i, r in enumerate(test.autocorrelation):
        sides = [Line.of(lags, np.full(lags.size, s * test.band), style=":", shade=GREY) for s in (-1, 1)]
        title = f"output {i + 1}: p white {test.whiteness_p[i]:.2g}, free of input {test.correlation_p[i].min():.2g}"
        panels.append(Panel([*sides, Line.of(lags, r)], title, "lag (samples)", "autocorrelation"))
    caption = "Residual correlations; 95 % of them lie between the dotted lines when the residual is white."
    return Figure("residuals", "Residual tests", caption, panels, 1, _size(panels, 1))


def uncertainty_figure(weight: UncertaintyWeight) -> Figure:
    """The bound on the model's error and the weight above it; above 0 dB a relative error leaves nothing to control."""
    bound = weight.uncertainty
    radius = bound.radius if bound.radius.ndim == 3 else bound.radius[None, None]
    gain = np.abs(weight.system.frequency_response(bound.f_hz))
    panels = [
        Panel(
            [
                Line.of(bound.f_hz, _db(radius[i, j]), "bound", shade=GREY),
                Line.of(bound.f_hz, _db(gain[i, j]), f"weight, {weight.excess_db:.1f} dB above on average"),
            ],
            bound.kind,
            HZ,
            "dB",
            x_log=True,
        )
        for i, j in np.ndindex(*radius.shape[:2])
    ]
    return Figure("uncertainty", "Uncertainty of the model", f"{bound.source}.", panels, 1, _size(panels, 1))


def _db(x: FloatArray) -> FloatArray:
    return 20.0 * np.log10(np.maximum(x, FLOOR))


def _size(panels: list[Panel], columns: int) -> tuple[float, float]:
    return PANEL_IN[0] * columns, PANEL_IN[1] * -(-len(panels) // columns)
