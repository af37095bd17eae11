"""Figures of evidence are drawn, one panel for each thing shown."""

import numpy as np
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet.plot import draw_svg
from ultraquiet.plot.evidence import band_figure, residual_figure, uncertainty_figure


def test_bands_residuals_and_uncertainty_are_drawn(rng):
    u = rng.standard_normal((2, 2000))
    y = lfilter([0, 0.5], [1, -0.8], u[0]) + lfilter([0, -0.2], [1, -0.5], u[1]) + 0.1 * rng.standard_normal(2000)
    record = uq.Record(u, y, 100.0)
    result = uq.identify.OutputError(order=1).identify(record)
    f = np.geomspace(0.5, 45, 40)
    figures = [
        (band_figure(uq.validate.response_band(result, f)), 4),
        (residual_figure(uq.validate.residual_test(result.model, record)), 1),
        (uncertainty_figure(uq.validate.from_covariance(result, f, "entry").weight(100.0, order=1)), 2),
    ]
    for figure, panels in figures:
        assert len(figure.panels) == panels
        assert draw_svg(figure).startswith("<svg")
