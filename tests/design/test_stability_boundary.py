"""A pole that no digit tells from the stability boundary is no pole of a stable loop, in whatever units."""

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from ultraquiet.analyse import gang_of_six, hinf_norm
from ultraquiet.deploy import reanalysis
from ultraquiet.design import BandAttenuation
from ultraquiet.design.loop_analysis import analyse_loop
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import judged
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, gain, series
from ultraquiet.values.status import StatusWord

RATE_HZ = 1000.0
SHAPES = [(1, 1), (4, 3), (3, 5)]


def mode(f_hz, damping):
    w = 2 * np.pi * f_hz
    return np.array([[-damping * w, w], [-w, -damping * w]])


def held(A, B, C, rate_hz, wires_into=1.0, wires_out=1.0):
    """The system behind a hold, in units of its channels; in continuous time as it is."""
    n, nu = B.shape
    if rate_hz is not None:
        M = expm(np.block([[A, B], [np.zeros((nu, n + nu))]]) / rate_hz)
        A, B = M[:n, :n], M[:n, n:]
    return StateSpace(A, B * wires_into, C * wires_out, np.zeros((len(C), nu)), rate_hz)


def drifting(rng, ny, nu, rate_hz, wires_into=1.0, wires_out=1.0):
    """Damped modes and an integrator that every actuator moves and every sensor sees."""
    A = block_diag(mode(20.0, 0.1), mode(90.0, 0.1), [[0.0]])
    B, C = rng.standard_normal((5, nu)), rng.standard_normal((ny, 5))
    return held(A, B * [[1.0]] * 10.0, C, rate_hz, wires_into, wires_out)


def washout(count, rate_hz):
    """A zero at 0 Hz on every channel."""
    one, pole = np.eye(count), 0.9 if rate_hz is not None else -60.0
    return StateSpace(one * pole, one, one * (pole - 1 if rate_hz is not None else pole), one, rate_hz)


def around(G, size=1e-3):
    """A static law of little gain, whatever the plant's units are."""
    low = np.abs(series(washout(G.D.shape[1], G.rate_hz), G).frequency_response([5.0, 20.0, 90.0])).max()
    return gain(-size * np.ones(G.D.shape[::-1]) / low, G.rate_hz)


@pytest.mark.parametrize("rate_hz", [None, RATE_HZ])
@pytest.mark.parametrize(("ny", "nu"), SHAPES)
def test_an_integrator_that_a_law_with_a_zero_there_does_not_hold_is_told_in_all_units(ny, nu, rate_hz):
    for into, out in [(1.0, 1.0), (3e5, 7e-8), (1.7e-6, 3.0)]:
        G = drifting(np.random.default_rng(7), ny, nu, rate_hz, into, out)
        K = series(washout(ny, rate_hz), around(G))
        found = analyse_loop(G, K, (5.0, 50.0))
        print(found.status)
        assert found.status.word is StatusWord.UNSTABLE
        assert "0 Hz (an integrator)" in found.status.sentence
        assert "the law does not hold it" in found.status.sentence
        assert not gang_of_six(G, K).stable
        assert hinf_norm(feedback(G, K))[0] == np.inf
        assert all(end.disk_all == 0 for end in found.margins.values())


@pytest.mark.parametrize("rate_hz", [None, RATE_HZ])
@pytest.mark.parametrize(("ny", "nu"), SHAPES)
def test_a_law_that_holds_the_integrator_is_stable_in_all_units(ny, nu, rate_hz):
    for into, out in [(1.0, 1.0), (3e5, 7e-8)]:
        G = drifting(np.random.default_rng(7), ny, nu, rate_hz, into, out)
        slow = np.outer(G.C[:, -1], G.B[-1])
        K = gain(-0.01 * slow.T / np.abs(slow).max() ** 2, rate_hz)
        assert analyse_loop(G, K, (5.0, 50.0)).stable


@pytest.mark.parametrize("rate_hz", [None, RATE_HZ])
@pytest.mark.parametrize("lacking", ["reach", "sight"])
@pytest.mark.parametrize("hidden", [np.zeros((1, 1)), mode(50.0, 0.0)], ids=["integrator", "undamped"])
def test_a_mode_on_the_boundary_that_is_hidden_from_the_law_is_told(hidden, lacking, rate_hz, rng):
    rest = block_diag(mode(20.0, 1e-3), mode(90.0, 1e-2))
    h, turn = len(hidden), np.linalg.qr(rng.standard_normal((4 + len(hidden), 4 + len(hidden))))[0]
    B = np.vstack([[[0, 0], [100, 30], [0, 0], [40, -60]], rng.standard_normal((h, 2)) * (lacking == "sight")])
    C = np.hstack([[[1, 0, 0.4, 0], [0.3, 0, -1, 0]], rng.standard_normal((2, h)) * (lacking == "reach")])
    G = held(turn @ block_diag(rest, hidden) @ turn.T, turn @ B, C @ turn.T, rate_hz)
    law = gain(np.array([[-1e-6, 0.0], [0.0, 1e-6]]), rate_hz)
    by_design = judged(G, law, StatedRobustness(), np.nan, np.nan, {}, {}).status
    for found in (by_design, analyse_loop(G, law, (5.0, 50.0)).status):
        print(found)
        assert found.word is StatusWord.UNSTABLE
        assert "on the boundary of stability" in found.sentence
        assert (
            "out of reach of the inputs" if lacking == "reach" else "does not show in the outputs"
        ) in found.sentence


@pytest.mark.parametrize("ny", [1, 3])
def test_two_poles_together_on_the_boundary_are_told_although_rounding_parts_them(ny, rng):
    """A double integrator that nothing reaches: its poles are computed some 1e-8 apart, inside as well as outside."""
    turn = np.linalg.qr(rng.standard_normal((4, 4)))[0]
    A = turn @ block_diag([[1.0, 1.0], [0.0, 1.0]], [[0.5, 0.1], [0.0, 0.4]]) @ turn.T
    B = turn @ np.vstack([np.zeros((2, 1)), np.ones((2, 1))])
    G = StateSpace(A, B, rng.standard_normal((ny, 4)), np.zeros((ny, 1)), RATE_HZ)
    assert G.boundary_hz().size
    assert analyse_loop(G, gain(-1e-3 * np.ones((1, ny)), RATE_HZ), (5.0, 50.0)).status.word is StatusWord.UNSTABLE


@pytest.mark.parametrize("scale", [1.0, 1e9, 1e-9])
def test_slow_and_lightly_damped_poles_inside_are_stable(scale):
    """3e-10 of the unit circle, as of 0.01 Hz at 20 kHz; several in one place; a delay line."""
    slow = held(mode(0.01, 1e-4), np.ones((2, 1)), np.ones((1, 2)), 20e3)
    line = np.eye(8, k=-1)
    twice = np.array([[1 - 1e-6, 1.0], [0.0, 1 - 1e-6]])
    for poles in (slow.A, line, twice, block_diag(slow.A, line, twice)):
        A = np.array(poles)
        d = scale ** np.linspace(0, 1, len(A))
        even = StateSpace(A * d[:, None] / d, np.ones((len(A), 1)), np.ones((1, len(A))), [[0.0]], 20e3)
        assert even.is_stable()
        assert not even.boundary_hz().size
    assert StateSpace(mode(1e-3, 1e-4) * scale, np.ones((2, 1)), np.ones((1, 2)), [[0.0]]).is_stable()


@pytest.mark.parametrize("slow", [0.0, 0.2])
def test_states_in_units_far_apart_are_evened_without_a_warning(slow):
    """Units of which no integer knows the quotient."""
    A = block_diag(mode(20.0, 0.1), [[-slow]]) + np.eye(3, k=1)
    far = np.array([1.0, 1e15, 1e-25])
    system = held(A * far[:, None] / far, np.ones((3, 1)) * far[:, None], np.ones((1, 3)) / far, None)
    assert system.is_stable() == (slow > 0)
    assert system.boundary_hz().size == (slow == 0)


def test_a_law_that_cancels_its_own_integrator_in_the_plant_is_told(rng):
    """The plant passes nothing at 0 Hz, where the law integrates."""
    G = series(washout(1, RATE_HZ), held(mode(30.0, 0.1), np.ones((2, 1)), np.ones((1, 2)), RATE_HZ))
    K = StateSpace([[1.0]], [[1e-2]], [[-1.0]], [[0.0]], RATE_HZ)
    found = analyse_loop(G, K, (5.0, 50.0)).status
    assert found.word is StatusWord.UNSTABLE
    assert "the law's own mode" in found.sentence


def test_a_pole_that_grows_is_told_as_such_beside_one_on_the_boundary(rng):
    G = drifting(rng, 1, 1, RATE_HZ)
    K = series(washout(1, RATE_HZ), around(G, 1e4))
    assert analyse_loop(G, K, (5.0, 50.0)).status.sentence.startswith("The loop is unstable;")


def test_a_rounded_law_that_does_not_hold_an_integrator_is_unstable():
    G = drifting(np.random.default_rng(7), 4, 3, RATE_HZ)
    K = series(washout(4, RATE_HZ), around(G))
    found = reanalysis(K, K, G, (20.0,))
    assert found.status.word is StatusWord.UNSTABLE


@pytest.mark.parametrize("unit", [10.0, 1e3, 1e6])
def test_band_attenuation_refuses_a_plant_that_drifts_in_all_units(unit):
    """Its law would have a zero at 0 Hz and leave the integrator alone."""
    A, B = block_diag([[0.0]], mode(17.0, 1e-4)), np.array([[1.0], [0.0], [2 * np.pi * 17]])
    G = held(A, B, np.array([[unit, 0.05 * unit, 0.0]]), 3500.0)
    line = StateSpace(np.eye(8, k=-1), np.eye(8, 1), np.eye(1, 8, k=7), [[0.0]], 3500.0)
    found = BandAttenuation(band_hz=(12.0, 24.0), height=12.0).design(series(line, G)).status
    assert found.word is StatusWord.REFUSED
    assert "0 Hz" in found.sentence
