"""Modes as moving shapes and spectra over time: of any model and record, in any units."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.bench import Hexapod
from ultraquiet.chart import HeatMap, Packing
from ultraquiet.plot import figure_of
from ultraquiet.plot.page import still_of
from ultraquiet.plot.pages.modes import SeenMode, _mostly, mode_shapes, strongest_modes
from ultraquiet.plot.pages.waterfall import density_in_time, waterfall
from ultraquiet.spectra import psd
from ultraquiet.values import Channel, Record, StateSpace
from ultraquiet.values.sketch import Sketch, row_of

RATE = 500.0
MODES = ((20.0, 0.01), (55.0, 0.02), (130.0, 0.8))


def plant(ny, nu, scale, rng):
    """Three modes with known shapes; the last is no vibration."""
    A, shapes = np.zeros((6, 6)), []
    B, C = np.zeros((6, nu)), np.zeros((ny, 6))
    for k, (f, zeta) in enumerate(MODES):
        pole = np.exp(2 * np.pi * f / RATE * (-zeta + 1j * np.sqrt(1 - zeta**2)))
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        B[2 * k], C[:, 2 * k + 1] = rng.standard_normal(nu), rng.standard_normal(ny)
        shapes.append(C[:, 2 * k + 1].copy())
    sensors = [Channel(f"y{i}", "m/s") for i in range(ny)]
    return StateSpace(A, B, scale * C, np.zeros((ny, nu)), RATE, sensors=sensors), shapes


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_shapes_are_those_of_the_modes(ny, nu, scale, rng):
    model, shapes = plant(ny, nu, scale, rng)
    found = strongest_modes(model, (5.0, 240.0))
    assert [round(mode.f_hz, 3) for mode in found] == [20.0, 55.0]
    for mode, (_, zeta), shape in zip(found, MODES[:2], shapes[:2], strict=True):
        assert mode.zeta == pytest.approx(zeta, rel=1e-6)
        assert np.abs(mode.shape.imag).max() < 1e-9
        assert abs(np.vdot(mode.shape, shape)) == pytest.approx(np.linalg.norm(mode.shape) * np.linalg.norm(shape))
        assert np.abs(mode.shape).max() == pytest.approx(1.0)
    scene = mode_shapes(model, (5.0, 240.0))
    assert len(scene.shapes) == 2
    assert "20 Hz" in scene.caption
    assert len(still_of(scene).panels) == 2
    assert len(Packing().spec(scene)["lines"]) == len(scene.lines)


def test_units_are_compared_each_with_its_own(rng):
    """A reading in other units of a million times the size hides none of the others."""
    model, _ = plant(3, 2, 1.0, rng)
    C = model.C * np.array([[1.0], [1.0], [1e6]])
    unlike = StateSpace(
        model.A, model.B, C, model.D, RATE, sensors=[Channel("a", "m/s"), Channel("b", "m/s"), Channel("c", "µrad/s")]
    )
    for mode in strongest_modes(unlike, (5.0, 240.0)):
        assert np.abs(mode.shape[:2]).max() == pytest.approx(1.0)
        assert abs(mode.shape[2]) == pytest.approx(1.0)


def test_without_a_vibration_there_is_no_scene():
    assert mode_shapes(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], RATE), (1.0, 200.0)) is None


def test_the_hexapods_platform_moves_as_its_struts_read():
    """A rigid motion of the platform, as its struts feel it, comes back as that motion of its joints."""
    drawn = Hexapod().sketch()
    base, platform = drawn.points[:6], drawn.points[6:]
    along = (platform - base) / np.linalg.norm(platform - base, axis=1, keepdims=True)
    shift, spin = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.7, -0.4])
    moves = shift + np.cross(spin, platform - platform.mean(axis=0))
    readings = np.sum(along * moves, axis=1)
    np.testing.assert_allclose((drawn.moves @ readings)[6:], moves, atol=1e-12)
    assert not drawn.moves[:6].any()
    assert Hexapod(instruments="all").sketch().moves.shape == (12, 3, 12)


@pytest.mark.parametrize("lines", [[(0, 2)], [(-1, 0)]])
def test_a_line_to_nowhere_is_refused(lines):
    with pytest.raises(InputError, match="not there"):
        Sketch(np.zeros((2, 3)), lines, np.zeros((2, 3, 1)))
    with pytest.raises(InputError, match="must be"):
        Sketch(np.zeros((2, 2)), [], np.zeros((2, 3, 1)))
    assert row_of(1).moves.shape == (2, 3, 1)


@pytest.mark.parametrize("scale", [1.0, 1e9, 1e-9])
def test_a_waterfall_adds_up_to_the_power_and_is_quieter_where_the_law_is(scale, rng):
    t = np.arange(4000) / RATE
    opened = scale * (np.sin(2 * np.pi * 25.0 * t) + 0.01 * rng.standard_normal((2, t.size)))
    at, power = density_in_time(opened[0], RATE, 100, 1000)
    assert at.size == 1000
    assert power.sum(axis=0).mean() * RATE / 100 == pytest.approx(np.mean(opened[0] ** 2), rel=0.05)
    assert power.mean() == pytest.approx(psd(opened[0], RATE, segment_samples=100).values.mean(), rel=0.1)
    sensors = [Channel("left", "mm/s"), Channel("right", "mm/s")]
    runs = {
        w: Record(np.ones((1, t.size)), y, RATE, None, sensors) for w, y in (("open", opened), ("closed", opened / 10))
    }
    chart = waterfall("law", 25.0, runs, (2.0, 200.0))
    shown = [panel.map for panel in chart.panels]
    assert shown[0].name == "density (dB re (mm/s)²/Hz)"
    assert shown[0].range == shown[1].range
    assert np.ptp(np.asarray(shown[0].z) - np.asarray(shown[1].z)) < 1e-6
    assert np.mean(np.asarray(shown[0].z) - np.asarray(shown[1].z)) == pytest.approx(20.0)
    still = figure_of(chart).panels[0].coloured
    assert still.values.shape == (still.y.size, still.x.size)


def test_a_map_of_other_size_is_refused():
    with pytest.raises(InputError, match="x 2 times y 3"):
        Packing()._shown(HeatMap("z", [1.0, 2.0], [1.0, 2.0, 3.0], np.zeros(5), (0.0, 1.0)))


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((1.0, 0.9, -0.1), "left and right together"),
        ((1.0, -0.9, 0.1), "left against right"),
        ((0.8, -0.9, 1.0), "rear and left against right"),
        ((0.1, -1.0, 0.1), "right"),
    ],
)
def test_of_a_mode_it_is_said_what_moves_with_what(shape, said):
    sensors = [Channel(name, "m/s") for name in ("left", "right", "rear")]
    plant = StateSpace([[0.5]], [[1.0]], np.ones((3, 1)), np.zeros((3, 1)), RATE, sensors=sensors)
    assert _mostly(plant, SeenMode(5.0, 0.01, 1.0, np.array(shape, dtype=complex))) == said
