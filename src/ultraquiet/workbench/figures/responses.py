"""Frequency responses: measured with coherence and confidence, models over them, poles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve, Range
from ultraquiet.plot.pages.transfer import RADIUS_95
from ultraquiet.spectra.coherence import TRUSTED
from ultraquiet.values.channel import Channel, ratio
from ultraquiet.workbench.figures.scale import Scale

FLOOR = 0.1  # of a gain: no confidence reaches lower in decibels
STRETCHED_DB = 10.0  # by which lines that nothing can be read from may widen what is drawn
AROUND = 8  # lines on either side: coherence of so few segments is above any limit somewhere by chance


@dataclass(frozen=True, eq=False)
class SeenResponse:
    """A measured response `(ny, nu, nf)` with coherence and variance."""

    f_hz: FloatArray
    values: ComplexArray
    coherence: FloatArray | None
    variance: FloatArray | None
    actuators: Sequence[Channel]
    sensors: Sequence[Channel]
    words: str = ""


@dataclass(frozen=True, eq=False)
class Modelled:
    """The response `(ny, nu, nf)` of a model, with the colour it keeps."""

    name: str
    f_hz: FloatArray
    values: ComplexArray
    colour: str


def response_grid(title: str, measured: SeenResponse | None, models: Sequence[Modelled], scale: Scale) -> Chart:
    """Return one panel a channel pair: gain over frequency; enlarged, with phase and coherence below."""
    first = measured if measured is not None else models[0]
    ny, nu = first.values.shape[:2]
    wires = None if measured is None else (measured.sensors, measured.actuators)
    limits = None if measured is None else _trusted_range(measured, models)
    panels = [_panel(i, j, measured, models, wires, scale, limits, ny * nu > 1) for i in range(ny) for j in range(nu)]
    caption = "" if measured is None else measured.words
    many = ny * nu > 4
    return Chart("responses", title, caption, panels, columns=nu, share=many, enlarge=True, legend="below")


def coherence_grid(measured: SeenResponse, scale: Scale) -> Chart:
    """Return the coherence of every channel pair, in the places of the responses."""
    assert measured.coherence is not None
    x = scale.x(measured.f_hz)
    ny, nu = measured.values.shape[:2]
    panels = [
        ChartPanel(
            scale.frequencies(),
            Axis("coherence", range=(0, 1.05)),
            [Curve("coherence", x, measured.coherence[i, j], "measured")],
            title=_pair(measured.sensors[i], measured.actuators[j]),
            height=96 if ny * nu > 4 else 120,
            tinted=i == j and nu > 1,
        )
        for i in range(ny)
        for j in range(nu)
    ]
    return Chart("coherence", "Coherence: where it is low, believe neither gain nor phase", "", panels, nu, ny * nu > 4)


def pole_map(title: str, models: Mapping[str, tuple[ComplexArray, str]]) -> Chart:
    """Return the poles of models, name -> (poles in z, colour), with the unit circle."""
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = Curve("unit circle", np.cos(angle), np.sin(angle), "muted", ":", "path")
    points = [Curve(name, p.real, p.imag, colour, kind="points", symbol="x") for name, (p, colour) in models.items()]
    axes = Axis("real part"), Axis("imaginary part")
    panel = ChartPanel(*axes, [circle, *points], height=400, aspect=1.15, equal=True)
    return Chart("poles", title, "Inside the circle: stable.", [panel])


def _panel(
    i: int,
    j: int,
    measured: SeenResponse | None,
    models: Sequence[Modelled],
    wires: tuple[Sequence[Channel], Sequence[Channel]] | None,
    scale: Scale,
    limits_db: Range | None,
    small: bool,
) -> ChartPanel:
    gains, phases, detail = [], [], []
    if measured is not None:
        x, g = scale.x(measured.f_hz), measured.values[i, j]
        low, high = _confidence(measured, i, j, scale)
        gains.append(Curve("measured", x, scale.y(g), "measured", low=low, high=high))
        phases.append(Curve("measured", x, _phase(g), "measured"))
    for m in models:
        x, g = scale.x(m.f_hz), m.values[i, j]
        gains.append(Curve(m.name, x, scale.y(g), m.colour))
        phases.append(Curve(m.name, x, _phase(g), m.colour))
    detail.append(ChartPanel(scale.frequencies(), Axis("phase (deg)", ticks="deg"), phases, height=180))
    if measured is not None and measured.coherence is not None:
        curve = Curve("coherence", scale.x(measured.f_hz), measured.coherence[i, j], "measured")
        detail.append(ChartPanel(scale.frequencies(), Axis("coherence", range=(0, 1.05)), [curve], height=110))
    unit, title = "", ""
    if wires is not None:
        unit = ratio(wires[0][i].unit, wires[1][j].unit)
        title = _pair(wires[0][i], wires[1][j])
    axis = scale.gains("" if small else "gain", "" if unit == "1/1" else unit, limits_db)
    tinted, height = small and i == j, 150 if small else 260
    return ChartPanel(scale.frequencies(), axis, gains, title, tinted=tinted, height=height, detail=detail)


def _trusted_range(measured: SeenResponse, models: Sequence[Modelled]) -> Range | None:
    """Return the decibels of all lines that can be trusted and of the models; None where the others add little.

    Where nothing was sent a measured gain is noise over nothing: it is drawn, and takes no room from what was measured.
    """
    if measured.coherence is None:
        return None
    with np.errstate(divide="ignore"):
        gains = 20 * np.log10(np.abs(measured.values))
        said = [20 * np.log10(np.abs(m.values)).ravel() for m in models]
    gains = np.where(np.isfinite(gains), gains, np.nan)
    around = [(0, 0), (0, 0), (AROUND, AROUND)]
    near = np.lib.stride_tricks.sliding_window_view(np.pad(measured.coherence, around, "edge"), 2 * AROUND + 1, -1)
    heard = gains[(np.median(near, axis=-1) >= TRUSTED) & np.isfinite(gains)]
    if not heard.size:
        return None
    both = np.concatenate([heard, *(db[np.isfinite(db)] for db in said)])
    low, high = float(both.min()), float(both.max())
    if np.nanmin(gains) > low - STRETCHED_DB and np.nanmax(gains) < high + STRETCHED_DB:
        return None
    room = max(0.05 * (high - low), 1.0)
    return low - room, high + room


def _confidence(measured: SeenResponse, i: int, j: int, scale: Scale) -> tuple[FloatArray | None, FloatArray | None]:
    if measured.variance is None:
        return None, None
    size = np.abs(measured.values[i, j])
    # the circle that holds the complex gain in 95 of 100 cases, as the report draws it
    spread = RADIUS_95 * np.sqrt(measured.variance[i, j])
    return scale.y(np.maximum(size - spread, FLOOR * size)), scale.y(size + spread)


def _phase(g: ComplexArray) -> FloatArray:
    return np.degrees(np.unwrap(np.angle(g)))


def _pair(sensor: Channel, actuator: Channel) -> str:
    return f"{actuator.name} → {sensor.name}"
