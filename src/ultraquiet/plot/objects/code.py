"""Code and its proof as figures."""

import numpy as np

from ultraquiet._base.shown import draws
from ultraquiet.deploy import Deployment, FrameSimulation, Reanalysis
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.plot.frame import frame_figure
from ultraquiet.plot.objects.anything import any_figure
from ultraquiet.plot.objects.models import model_figure

draws(FrameSimulation)(frame_figure)


@draws(Deployment)
def deployment_figure(deployment: Deployment) -> Figure:
    """The law that the code runs."""
    return any_figure(deployment) if deployment.designed is None else model_figure(deployment.designed)


@draws(Reanalysis)
def reanalysis_figure(found: Reanalysis) -> Figure:
    """Attenuation of each tone in the worst direction, as designed and with rounded coefficients."""
    tones = np.asarray(found.tones_hz, dtype=float)
    if tones.size < 2:
        return any_figure(found)
    lines = [
        Line.of(tones, found.designed.attenuation_db, "as designed"),
        Line.of(tones, found.rounded.attenuation_db, "with the rounded law", "--", 1),
    ]
    panel = Panel(lines, "worst direction", "tone (Hz)", "dB", x_log=True)
    return Figure("reanalysis", "The loop with the rounded law", str(found.status), [panel])
