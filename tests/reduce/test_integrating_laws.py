"""Laws that integrate: their poles on the boundary of stability stay, wherever rounding puts them."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design import LoopShaping, Lqg
from ultraquiet.linalg.balance import BOUNDARY, stable_first
from ultraquiet.reduce import Balanced, ClosedLoopWeighted, FrequencyWeighted, HankelNorm
from ultraquiet.reduce._abstract import split
from ultraquiet.reduce.certificate import judging_plant
from ultraquiet.reduce.promises import Judge, Promise
from ultraquiet.reduce.stepwise import loop_gramians
from ultraquiet.reduce.weighting import input_gramian
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import lft, sensitivity

BOUNDED = (Balanced, HankelNorm)
ALONE = (*BOUNDED, FrequencyWeighted)


def integrating(rng, nu, ny, rate_hz, integrators, scale=1.0):
    """Return stable states beside integrators, one after the other, in coordinates that show neither."""
    n = 4 + integrators
    fast = rng.standard_normal((4, 4))
    if rate_hz:
        fast *= 0.8 / np.abs(np.linalg.eigvals(fast)).max()
        A = block_diag(fast, np.eye(integrators) + 0.1 * np.eye(integrators, k=1))
    else:
        fast -= (np.linalg.eigvals(fast).real.max() + 0.3) * np.eye(4)
        A = block_diag(fast, np.eye(integrators, k=1))
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    B, C = rng.standard_normal((n, nu)), scale * rng.standard_normal((ny, n))
    return StateSpace(T.T @ A @ T, T.T @ B, C @ T, np.zeros((ny, nu)), rate_hz)


@pytest.fixture(scope="module")
def servo():
    """A resonant plant, 1 kHz, and a law for it with a pole at z = 1."""
    A = [[0.98, 0.1, 0.0], [-0.1, 0.98, 0.0], [0.0, 0.0, 0.5]]
    plant = StateSpace(A, [[0.0], [0.1], [0.1]], [[0.3, 1.0, 0.2]], [[0.0]], rate_hz=1000.0)
    law = Lqg(control_weight=0.01, disturbance=1.0, sensor_noise=0.01, integral_hz=2.0).design(plant).controller
    return plant, law


@pytest.mark.parametrize("method", ALONE)
def test_a_discrete_integrator_is_kept_whole(method):
    law = StateSpace([[1.0, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.1, 0.01]], [[0.0]], rate_hz=100.0)
    small = method(states=1).reduce(law)
    assert small.status.ok
    assert small.controller.poles() == pytest.approx([1.0], abs=1e-12)


@pytest.mark.parametrize("method", BOUNDED)
@pytest.mark.parametrize("integrators", [1, 2])
@pytest.mark.parametrize("rate_hz", [None, 100.0])
@pytest.mark.parametrize(("nu", "ny", "scale"), [(1, 1, 1.0), (3, 4, 1e-9), (5, 3, 1e6)])
def test_integrators_in_any_coordinates_stay_and_the_bound_holds(rng, method, integrators, rate_hz, nu, ny, scale):
    law = integrating(rng, nu, ny, rate_hz, integrators, scale)
    small = method(states=2 + integrators).reduce(law)
    f_hz = np.array([0.5, 1.0, 3.0, 20.0])
    off = small.controller.frequency_response(f_hz) - law.frequency_response(f_hz)
    error = np.linalg.norm(np.moveaxis(off, 2, 0), 2, axis=(1, 2)).max()
    print(f"{method.__name__}, {integrators} integrators: {error:.3g} of at most {small.bound:.3g}")
    assert small.controller.states == 2 + integrators
    assert error <= small.bound * 1.001
    on = np.abs(np.abs(small.controller.poles()) - 1.0) if rate_hz else np.abs(small.controller.poles())
    assert np.count_nonzero(on < 1e-6) == integrators


@pytest.mark.parametrize("inside", [0.0, 4e-16, 2e-15, -2e-15])
def test_a_few_units_of_rounding_do_not_make_an_integrator_stable(inside):
    for A, discrete in ((np.diag([1 - inside, 0.5]), True), (np.diag([-inside, -3.0]), False)):
        assert stable_first(A, discrete, BOUNDARY)[2] == 1


def test_a_reduction_by_the_loop_keeps_the_integrator(servo):
    plant, law = servo
    assert np.abs(law.poles() - 1.0).min() < 1e-12
    for reduction in (ClosedLoopWeighted(states=3), ClosedLoopWeighted()):
        small = reduction.reduce(law, plant)
        print(small.status)
        assert small.status.word != "unstable"
        assert np.abs(small.controller.poles() - 1.0).min() < 1e-9


def test_an_integrator_promises_a_band_and_not_the_round_off_at_rest(servo):
    plant, law = servo
    judge = Judge(plant, law, Promise.of(law))
    grid = np.geomspace(0.005, 1.0, 500)
    lines = np.abs(1 / (1 - plant.frequency_response(grid) * law.frequency_response(grid)))[0, 0]
    print(f"{judge.before.band_db:.1f} dB in the band, {-20 * np.log10(lines.min()):.1f} dB at best")
    assert judge.before.band_db == pytest.approx(-10 * np.log10(lines.min()), rel=0.01)


def test_gramians_behind_a_slow_weight_are_none_the_less_definite():
    """A loop shaped over a band that begins far below it has modes of 10^5 samples that hardly show in its weights."""
    A = [[0.98, 0.1, 0.0], [-0.1, 0.98, 0.0], [0.0, 0.0, 0.5]]
    plant = StateSpace(A, [[0.0], [0.1], [0.1]], [[0.3, 1.0, 0.2]], [[0.0]], rate_hz=1000.0)
    law = LoopShaping(integral_hz=1.0, band_hz=even_plant(plant).band_hz).design(plant).controller
    assert law is not None
    stable, _, _ = split(law)
    W = sensitivity(plant, law)
    P = input_gramian(stable, (W.A, W.B, W.C, W.D), discrete=True)
    loop = lft(judging_plant(plant, None), law)
    for each in (P, *loop_gramians(judging_plant(plant, None), loop, 1)):
        values = np.linalg.eigvalsh(each)
        print(f"{values[0]:.2e} to {values[-1]:.2e}")
        assert values[0] > -1e-12 * values[-1]
    for method in (FrequencyWeighted(), ClosedLoopWeighted(states=11)):
        small = method.reduce(law, plant)
        assert small.status.ok, small.status
        assert small.controller.states < law.states
