"""Measured responses as they are drawn: lines of which nothing can be read take no room from the others."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.values import Channel
from ultraquiet.workbench.figures.responses import Modelled, SeenResponse, response_grid
from ultraquiet.workbench.figures.scale import Scale
from ultraquiet.workbench.figures.traces import correlations

F_HZ = np.linspace(1.0, 500.0, 300)
WIRES = ([Channel("push", "N")], [Channel("stage", "m")])


def seen(coherence, far=1.0):
    """A gain of one, `far` times as much where nothing was sent: above 400 Hz."""
    values = np.where(F_HZ > 400, far, 1.0)[None, None].astype(complex)
    return SeenResponse(F_HZ, values, coherence[None, None], None, *WIRES)


def heard():
    return np.where(F_HZ > 400, 0.3, 1.0)


def range_of(response, *models, decibels=True):
    return response_grid("r", response, models, Scale(decibels=decibels)).panels[0].y.range


def test_where_nothing_was_sent_the_axis_does_not_follow():
    low, high = range_of(seen(heard(), far=1e5))
    assert -3 < low < 0 < high < 3
    chance = heard()
    chance[-3] = 0.9  # one line of many, as noise has it
    assert range_of(seen(chance, far=1e5)) == (low, high)


def test_the_axis_fits_itself_where_there_is_nothing_to_leave_out():
    assert range_of(seen(heard(), far=2.0)) is None
    assert range_of(seen(np.ones(300), far=1e5)) is None
    assert range_of(seen(np.zeros(300), far=1e5)) is None


def test_what_a_model_says_is_seen_whole():
    model = Modelled("m", F_HZ, np.full((1, 1, 300), 100.0 + 0j), "chosen")
    low, high = range_of(seen(heard(), far=1e5), model)
    assert low < 0
    assert high > 40


def test_plain_gains_have_an_axis_of_their_own():
    assert range_of(seen(heard(), far=1e5), decibels=False) is None


@pytest.mark.parametrize("gain", [0.0, np.nan])
def test_a_channel_of_nothing_is_no_reason_to_fail(gain):
    empty = SeenResponse(F_HZ, np.full((1, 1, 300), gain + 0j), np.ones((1, 1, 300)), None, *WIRES)
    assert range_of(empty) is None


def test_residuals_are_drawn_from_the_first_lag_that_says_something():
    auto, cross = np.array([[1.0, 0.02, -0.03]]), np.array([[0.01, 0.02, 0.04]])
    own, inputs = correlations("r", auto, cross, 0.05, ["stage"]).panels
    assert list(own.curves[0].x) == [1, 2]
    assert list(own.curves[0].y) == [0.02, -0.03]
    assert sorted(mark.y for mark in own.marks) == [-0.05, 0.05]
    assert list(inputs.curves[0].y) == [0.01, 0.02, 0.04]
    assert [mark.y for mark in inputs.marks] == [0.05]


@pytest.mark.parametrize(("units", "label"), [(("N", "N"), "gain ((m/s)/N)"), (("N", "V"), "gain (m/s per unit)")])
def test_what_disturbances_leave_has_the_unit_of_a_gain_and_names_the_output_that_gains_least(units, label):
    pytest.importorskip("nicegui")
    from ultraquiet.workbench.web.pages.closed_loop import noise_figure

    plant = uq.StateSpace(
        0.9 * np.eye(2),
        0.1 * np.eye(2),
        np.eye(2),
        np.zeros((2, 2)),
        350.0,
        actuators=[uq.Channel(f"force {k}", unit) for k, unit in enumerate(units)],
        sensors=[uq.Channel("still", "m/s"), uq.Channel("loud", "m/s")],
    )
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.diag([-2.0, 1.0]), 350.0)
    chart = noise_figure("law", plant, law)
    assert [panel.y.label for panel in chart.panels] == [label] * 2
    opened, closed = (np.asarray(curve.y) for curve in chart.panels[1].curves)
    assert (closed[:10] > opened[:10]).all()
    assert "The rms that gains least is that of loud: louder by " in chart.caption
