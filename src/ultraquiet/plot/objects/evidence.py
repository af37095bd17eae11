"""Spectra and evidence on models: the figures of `plot.spectra` and `plot.evidence`, found by their objects."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown import draws
from ultraquiet.identify import Sweep
from ultraquiet.plot import evidence, spectra
from ultraquiet.plot.figure import Figure, Fill, Line, Panel
from ultraquiet.plot.objects.anything import any_figure
from ultraquiet.spectra import (
    BandLevels,
    BestLinear,
    Coherence,
    Criterion,
    LocalPolynomial,
    PowerSpectrum,
    Transmissibility,
)
from ultraquiet.validate import ResidualTest, UncertaintyWeight

draws(PowerSpectrum)(spectra.density_figure)
draws(Transmissibility)(spectra.transmissibility_figure)
draws(BandLevels)(spectra.bands_figure)
draws(ResidualTest)(evidence.residual_figure)
draws(UncertaintyWeight)(evidence.uncertainty_figure)


@draws(BestLinear, LocalPolynomial)
def best_figure(best: BestLinear | LocalPolynomial) -> Figure:
    """The response that was found, with its standard error."""
    return spectra.response_figure(best.response)


@draws(Coherence)
def coherence_figure(coherence: Coherence) -> Figure:
    """Multiple coherence of each output, and the ordinary one with each input."""
    panels = [
        Panel(
            [
                Line.of(coherence.f_hz, coherence.multiple[i], "multiple"),
                *(
                    Line.of(coherence.f_hz, coherence.ordinary[i, j], actuator.name, "--", j + 1)
                    for j, actuator in enumerate(coherence.actuators)
                ),
            ],
            sensor.name,
            spectra.HZ,
            "coherence",
            x_log=bool((coherence.f_hz > 0).all()),
            y_range=(0.0, 1.05),
        )
        for i, sensor in enumerate(coherence.sensors)
    ]
    return Figure("coherence", "Coherence", "", panels, 1, (8.0, 2.4 * len(panels)))


@draws(Criterion)
def criterion_figure(criterion: Criterion) -> Figure:
    """The limit over the third octaves that it is stated for."""
    centre = criterion.bands.centre_hz
    line = Line.of(centre, 1e6 * criterion.limit_m_s(centre), criterion.name, "--")
    panel = Panel([line], criterion.name, spectra.HZ, "rms (µm/s)", x_log=True, y_log=True)
    return Figure("criterion", criterion.name, "Largest rms velocity in third octaves.", [panel])


@draws(Sweep)
def sweep_figure(sweep: Sweep) -> Figure:
    """Fit on the record and on what was held out, candidate by candidate."""
    if not sweep.candidates:
        return any_figure(sweep)
    k = np.arange(1.0, len(sweep.candidates) + 1)
    held, seen = (_worst([getattr(c, name) for c in sweep.candidates]) for name in ("held_out_fit", "fit_percent"))
    fill = Fill(k, np.minimum(held, seen), np.maximum(held, seen), "what the record flatters")
    lines = [Line.of(k, held, "held out"), Line.of(k, seen, "on the record", "--", 7)]
    panel = Panel(lines, "worst output", "candidate", "fit (%)", fills=[fill])
    return Figure("sweep", "Order choice", f"Preferred: {sweep.preferred}", [panel])


def _worst(fits: list[FloatArray]) -> FloatArray:
    return np.array([float(np.min(each)) for each in fits])
