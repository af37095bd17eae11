"""What a model leaves of a record, as the report draws it."""

import numpy as np

from ultraquiet.plot.pages.residuals import residual_chart


def test_the_caption_names_the_sensor_that_leaves_the_band_most(rng):
    band, lags = 0.1, 25
    white, coloured = 0.5 * band * rng.uniform(-1, 1, lags), 0.9 ** np.arange(1, lags + 1)
    chart = residual_chart(
        "preferred", "noise", ("left", "right"), np.vstack([white, coloured]), band, np.array([0.4, 0.0])
    )
    share = np.mean(coloured > band)
    assert f"right does most often, at {100 * share:.0f} % of the lags" in chart.caption
    assert [panel.title for panel in chart.panels] == ["left", "right"]
    for panel, drawn in zip(chart.panels, (white, coloured), strict=True):
        np.testing.assert_array_equal(panel.curves[0].y, drawn)
        np.testing.assert_array_equal(panel.curves[0].x, np.arange(1, lags + 1))
        assert sorted(mark.y for mark in panel.marks) == [-band, band]
