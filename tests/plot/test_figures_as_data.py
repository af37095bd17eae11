"""Every figure before it is drawn: its lines are the numbers given, its axes fit them and name their units."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet import spectra
from ultraquiet.analyse import EndMargins
from ultraquiet.plot import study
from ultraquiet.plot.evidence import band_figure, residual_figure, uncertainty_figure
from ultraquiet.plot.figure import MOST_POINTS, thin
from ultraquiet.plot.frame import frame_figure
from ultraquiet.plot.spectra import bands_figure, density_figure, response_figure, transmissibility_figure
from ultraquiet.spectra.coherence import TRUSTED
from ultraquiet.values import Channel, Record, StateSpace

RATE_HZ = 500.0
SEGMENT = 500
NAMES = ["base x", "base y", "payload x", "payload y"]
# A panel says what its axis carries by one of these, on the axis, in its title or in the caption.
UNITS = ("Hz", "(s)", "V", "dB", "degrees", "m/s", "samples", "us", "autocorrelation", "coherence", "1/g")


@pytest.fixture(scope="module")
def record():
    """Two shakers, two sensors on the base and two on a payload behind a resonance, in metres per second."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal((2, 8000))
    w = 2 * np.pi * 12.0 / RATE_HZ
    A = 0.98 * np.array([[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]])
    plant = StateSpace(A, 0.1 * np.eye(2), [[1, 0], [0.2, 1]], np.zeros((2, 2)), RATE_HZ)
    base = u + 0.1 * rng.standard_normal(u.shape)
    payload = plant.simulate(base) + 0.01 * rng.standard_normal(u.shape)
    sensors = [Channel(name, "m/s") for name in NAMES]
    actuators = [Channel(name, "N") for name in ("push x", "push y")]
    return Record(u, np.vstack([base, payload]), RATE_HZ, actuators, sensors)


@pytest.fixture(scope="module")
def result(record):
    return uq.identify.OutputError(order=2).identify(record.pick([0, 1], [2]))


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    law = StateSpace([[0.5]], [[0.1]], [[0.2]], [[0.0]], 3500.0)
    code = uq.deploy.generate(law, tmp_path_factory.mktemp("code"), ramp_s=0.01)
    return uq.deploy.Frame(load=0.3, overloads=(uq.deploy.Overload(40, 1, 2 / 3500.0),)).simulate(code, 200)


F_HZ = np.geomspace(1.0, 200.0, 60)


def responses(record):
    """Responses to both inputs of two models, as the paper's figures take them."""
    values = spectra.frf(record, segment_samples=SEGMENT).values
    f_hz = spectra.frf(record, segment_samples=SEGMENT).f_hz
    return [("first", f_hz[1:], values[:, :, 1:]), ("second", f_hz[1:], 2 * values[:, :, 1:])]


def wires(record):
    return record.actuators, record.sensors


FIGURES = {
    "density": lambda record, result, frames: density_figure(spectra.psd(record, segment_samples=SEGMENT)),
    "response": lambda record, result, frames: response_figure(spectra.frf(record, segment_samples=SEGMENT)),
    "transmissibility": lambda record, result, frames: transmissibility_figure(
        spectra.transmissibility(record, NAMES[:2], NAMES[2:], segment_samples=SEGMENT)
    ),
    "bands": lambda record, result, frames: bands_figure(
        spectra.band_levels(spectra.psd(record, segment_samples=2000), start_hz=8, stop_hz=80)
    ),
    "confidence": lambda record, result, frames: band_figure(uq.validate.response_band(result, F_HZ)),
    "residuals": lambda record, result, frames: residual_figure(
        uq.validate.residual_test(result.model, record.pick([0, 1], [2]))
    ),
    "uncertainty": lambda record, result, frames: uncertainty_figure(
        uq.validate.from_covariance(result, F_HZ, "entry").weight(RATE_HZ, order=1)
    ),
    "frame": lambda record, result, frames: frame_figure(frames),
    "test-signals": lambda record, result, frames: study.excitation_signals(
        {"noise": (record, 0), "more": (record, 1)}
    ),
    "responses": lambda record, result, frames: study.responses("noise", record, 1),
    "simulation": lambda record, result, frames: study.simulation(
        "step", record.part(0, 800), {"model": np.ones(800)}, 0, 1
    ),
    "bode": lambda record, result, frames: study.bode(responses(record), wires(record), 1, 0, (2.0, 200.0)),
}  # fmt: skip


@pytest.fixture(params=FIGURES)
def figure(request, record, result, frames):
    return FIGURES[request.param](record, result, frames)


def lines_of(figure):
    return [(panel, line) for panel in figure.panels for line in panel.lines]


def test_lines_are_numbers_that_can_be_drawn(figure):
    for panel, line in lines_of(figure):
        assert line.x.shape == line.y.shape
        assert 2 <= line.x.size <= MOST_POINTS
        assert np.isfinite(line.x).all()
        assert np.isfinite(line.y).any()
        if panel.x_log:
            assert line.x.min() >= 0  # matplotlib leaves a line at 0 Hz out
            assert np.sum(line.x > 0) >= 2
        if panel.y_log:
            assert line.y[np.isfinite(line.y)].min() > 0


def test_axes_fit_the_data(figure):
    """Where an axis is fixed it holds every point, but for gains without coherence, which may leave the picture."""
    for panel, line in lines_of(figure):
        shown = slice(None)
        if panel.x_range:
            low, high = panel.x_range
            shown = (line.x >= low) & (line.x <= high)
            assert shown.any()
            assert low < high
        if panel.y_range and figure.name not in ("response", "transmissibility"):
            y = line.y[shown]
            assert panel.y_range[0] <= np.nanmin(y), panel.title
            assert np.nanmax(y) <= panel.y_range[1], panel.title


def test_every_panel_says_what_it_shows_and_in_which_unit(figure):
    assert figure.name
    assert figure.title
    assert figure.caption.endswith(".")
    below = " ".join([figure.caption, *(panel.x_label for panel in figure.panels)])  # panels of a column share an axis
    for panel in figure.panels:
        said = " ".join((panel.title, panel.x_label, panel.y_label, figure.caption))
        assert any(unit in said for unit in UNITS) or panel.x_label == "s", said
        assert not panel.x_log or "Hz" in below  # a logarithm is a frequency's


def test_panels_fill_whole_rows_and_the_sheet_grows_with_them(figure):
    rows = -(-len(figure.panels) // figure.columns)
    assert len(figure.panels) > (rows - 1) * figure.columns
    width, height = figure.size_in
    assert width / figure.columns > 1.0  # inches a panel
    assert height / rows > 1.0


def test_legends_name_each_curve_once(figure):
    for panel in figure.panels:
        names = [line.label for line in panel.lines if line.label]
        assert len(set(names)) == len(names)


def test_densities_are_those_of_the_spectrum(record):
    spectrum = spectra.psd(record, segment_samples=SEGMENT)
    figure = density_figure(spectrum)
    for k, channel in enumerate(spectrum.channels):
        density, total = figure.panels[2 * k : 2 * k + 2]
        assert density.title == channel.name
        unit = f"({channel.unit})" if "/" in channel.unit else channel.unit
        assert density.y_label == f"dB re {unit}/√Hz"
        assert density.lines[-1].y == pytest.approx(20 * np.log10(spectrum.asd[k, 1:]))
        assert density.lines[0].label == "95 % interval"
        below, above = (line.y for line in density.lines[:2])
        assert (below < density.lines[-1].y).all()
        assert (density.lines[-1].y < above).all()
        assert total.y_label == channel.unit
        assert total.lines[0].y[-1] == pytest.approx(spectrum.rms()[k], rel=1e-6)
    assert spectrum.estimator in figure.caption


def test_gains_are_drawn_where_they_are_coherent(record):
    response = spectra.frf(record, segment_samples=SEGMENT)
    figure = response_figure(response)
    assert figure.columns == 3
    gains, phases, shares = (figure.panels[k::3] for k in range(3))
    for i, (gain, phase, share) in enumerate(zip(gains, phases, shares, strict=True)):
        assert gain.y_label == "dB re (m/s)/N"
        assert [line.label for line in gain.lines if line.label] == ["push x", "push y"]
        db = 20 * np.log10(np.abs(response.values[i]))
        for j in range(2):
            line = next(one for one in gain.lines if one.label == f"push {'xy'[j]}")
            assert line.y == pytest.approx(db[j])
            low, high = gain.y_range
            trusted = response.coherence[i, j] > TRUSTED
            assert (db[j][trusted] <= high).all()
            assert (db[j][trusted] >= low).all()
            turned = np.exp(1j * np.radians(phase.lines[j].y))
            assert turned == pytest.approx(response.values[i, j] / np.abs(response.values[i, j]))
        assert len(share.lines) == 1  # what both explain together: one curve, not the same one twice
        assert share.lines[0].y == pytest.approx(response.coherence[i, 0])
        assert share.y_range[0] <= 0.0
        assert share.y_range[1] >= 1.0


def test_velocities_stand_among_the_vibration_criteria(record):
    spectrum = spectra.psd(record, segment_samples=2000)
    levels = spectra.band_levels(spectrum, start_hz=8, stop_hz=80)
    panel = bands_figure(levels).panels[0]
    assert panel.y_label == "rms (µm/s)"
    for k, name in enumerate(("push x", "push y", *NAMES)[-len(levels.channels) :]):
        line = next(one for one in panel.lines if one.label == name)
        assert line.x == pytest.approx(levels.bands.centre_hz)
        scale = 1e6 if levels.channels[k].unit == "m/s" else 1.0
        assert line.y == pytest.approx(scale * levels.rms[k])


def test_bode_curves_are_gain_and_phase(record):
    both = responses(record)
    figure = study.bode(both, wires(record), 1, 0, (2.0, 200.0), " (Elsewhere: Fig. 3.)")
    magnitude, phase = figure.panels
    for k, (name, f_hz, values) in enumerate(both):
        assert magnitude.lines[k].label == name
        assert magnitude.lines[k].x == pytest.approx(f_hz)
        assert magnitude.lines[k].y == pytest.approx(20 * np.log10(np.abs(values[1, 0])))
        turned = np.exp(1j * np.radians(phase.lines[k].y))
        assert turned == pytest.approx(values[1, 0] / np.abs(values[1, 0]))
    first, second = record.actuators[0], record.sensors[1]
    assert first.name in figure.caption
    assert second.name in figure.caption
    assert figure.caption.endswith("(Elsewhere: Fig. 3.)")
    assert phase.y_label == "phase (°)"
    assert magnitude.x_range == phase.x_range == (2.0, 200.0)


def test_time_responses_show_bench_and_models_on_one_clock(record):
    short = record.part(0, 800)
    model = np.linspace(0, 1, 800)
    command, reading = study.simulation("step", short, {"model": model}, 0, 1).panels
    assert command.lines[0].y == pytest.approx(short.inputs[0])
    assert command.y_label == f"command ({short.actuators[0].unit})"
    assert [line.label for line in reading.lines] == ["bench", "model"]
    assert reading.lines[0].y == pytest.approx(short.outputs[1])
    assert reading.lines[1].y == pytest.approx(model)
    assert reading.y_label == f"reading ({short.sensors[1].unit})"


def test_of_a_long_tone_the_last_periods_are_shown(record):
    t = np.arange(4000) / RATE_HZ
    tone = Record(np.sin(2 * np.pi * 25 * t)[None], np.cos(2 * np.pi * 25 * t)[None], RATE_HZ)
    command, _ = study.simulation("tone", tone, {"model": t}, 0, 0).panels
    shown_s = np.ptp(command.lines[0].x)
    assert 10 / 25 < shown_s < 14 / 25
    assert command.lines[0].x[-1] == pytest.approx(tone.time_s[-1])


def test_units_of_gains_are_those_of_the_channels():
    def wire(unit):
        return [uq.Channel("a", unit)]

    assert study.gain_unit((wire("V"), wire("V"))) == "dB re V/V"
    assert study.gain_unit((wire("N"), wire("m/s"))) == "dB re (m/s)/N"
    assert study.gain_unit((wire(""), wire(""))) == "dB"
    assert study.gain_unit((wire("N") + wire("V"), wire("m"))) == "dB"


def test_the_frame_figure_counts_what_the_code_counted(frames):
    line, every, counters = frame_figure(frames).panels
    spans = frames.spans_us(frames.worst_frame)
    assert [one.label for one in line.lines] == [name for name, _, _ in spans]
    assert [one.x.tolist() for one in line.lines] == [[a, b] for _, a, b in spans]
    assert every.lines[0].y.max() == pytest.approx(1e6 * frames.worst_s)
    assert every.lines[2].y == pytest.approx([1e6 / 3500.0] * 2)
    assert counters.lines[1].label == f"overruns, of {frames.overrun_count}"
    assert frames.overrun_count > 0
    assert counters.lines[1].y.max() == 1.0


def test_thinned_lines_keep_every_extreme(rng):
    x, y = np.arange(100_000.0), rng.standard_normal(100_000)
    k = int(rng.integers(100_000))
    y[k] = 50.0
    few_x, few_y = thin(x, y)
    assert few_x.size <= MOST_POINTS
    assert (np.diff(few_x) > 0).all()
    assert y[few_x.astype(int)] == pytest.approx(few_y)
    assert (few_y.min(), few_y.max()) == (y.min(), 50.0)
    assert few_x[np.argmax(few_y)] == k


def test_margins_are_bars_and_what_nothing_upsets_is_named():
    margins = EndMargins(
        gain_up_db=np.array([6.0, np.inf, 3.0]), gain_down_db=np.full(3, np.inf), phase_deg=np.full(3, 40.0),
        delay_s=np.full(3, 1e-3), disk=np.array([0.5, 0.6, 0.7]), disk_all=0.4, disk_all_hz=3.0, least_change=None,
    )  # fmt: skip
    up, down, *others = uq.plot.figure(margins).panels
    assert np.nanmax(up.lines[0].y) == 6.0
    assert sorted({round(float(x)) for x in up.lines[0].x[np.isfinite(up.lines[0].x)]}) == [0, 2]
    assert up.title == "gain up; nothing upsets channel 2"
    assert not down.lines
    assert down.words
    assert [panel.x_names for panel in (up, *others)] == [["1", "2", "3"]] * 4


@pytest.mark.parametrize(("moving", "shades"), [((1,), [7, 0, 7]), ((0, 1), [0, 0, 0])])
def test_the_sensor_of_the_one_actuator_that_moves_stands_out(moving, shades):
    inputs, t = np.zeros((2, 50)), np.linspace(0.0, 1.0, 50)
    inputs[list(moving)] = np.sin(9 * t)
    panels = study.responses("noise", Record(inputs, np.ones((3, 50)) * t, 50.0), 1).panels
    assert [panel.lines[0].shade for panel in panels] == shades
