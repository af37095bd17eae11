"""What a model leaves of a record: its residuals' correlation with their own past, lag by lag."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import chance, in_percent
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark

COLUMNS = 3


def residual_chart(
    model: str, record: str, sensors: Sequence[str], autocorrelation: FloatArray, band: float, whiteness_p: FloatArray
) -> Chart:
    """Draw the autocorrelation `(ny, lags)` at lags 1, 2, ... of every sensor's residual between +-`band`.

    Args:
        model: its name, for the caption.
        record: its name, for the caption.
        sensors: names, `ny` of them.
        autocorrelation: coefficients; 95 % of a white residual's lie within the band.
        band: its half width.
        whiteness_p: `(ny,)` p-values that the residual is white.
    """
    lags = np.arange(1.0, autocorrelation.shape[1] + 1)
    marks = [Mark("95 % of white noise", y=end * band) for end in (-1, 1)]
    panels = [
        ChartPanel(
            Axis("lag (samples)"), Axis("correlation (1)"), [Curve("residual", lags, r, "measured", kind="stems")],
            name, marks=marks, height=150,
        )
        for name, r in zip(sensors, autocorrelation, strict=True)
    ]  # fmt: skip
    beyond = np.mean(np.abs(autocorrelation) > band, axis=1)
    worst = int(np.argmax(beyond))
    caption = (
        f"Correlation of the one-step error of the {model} model with its own past, '{record}'. White noise leaves the "
        f"dashed band at one lag of twenty; {sensors[worst]} does most often, at {in_percent(beyond[worst])} of the "
        f"lags (p {chance(float(whiteness_p[worst]))})."
    )
    return Chart("residuals", "Residuals", caption, panels, min(COLUMNS, len(panels)))
