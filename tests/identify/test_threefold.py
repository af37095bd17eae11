"""Six functions in the place of 36: what averaging gains, and the test that struts are alike."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.identify import StructuredModal, Threefold
from ultraquiet.identify.grey_box.threefold import contrasts, fold, transform
from ultraquiet.values import FrequencyResponse

RATE_HZ = 3500.0
F_HZ = np.geomspace(3.0, 200.0, 60)
DRAWS = 200


def symmetric(rng):
    """A stable system of six functions, drawn afresh."""
    from scipy.linalg import block_diag

    def loop(n):
        A = np.diag(np.exp(-2 * np.pi * rng.uniform(5, 150, 4) / RATE_HZ))
        return A, rng.standard_normal((4, n)), rng.standard_normal((n, 4)) * 0.05, np.zeros((n, n))

    one, two, H = loop(1), loop(1), loop(2)
    A, B, C, D = (block_diag(*(p[k] for p in (one, two, H, H))) for k in range(4))
    T = transform()
    return uq.StateSpace(A, B @ T.T, T @ C, D, RATE_HZ)


def noisy(rng, G, deviation):
    e = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
    return FrequencyResponse(F_HZ, G + deviation * e / np.sqrt(2), variance=deviation**2 * np.ones(G.shape))


def realisations(rng, G, count=6, distortion=0.02):
    """Distortion enters at an actuator and is alike at all sensors; noise enters at the sensors."""
    out = []
    for _ in range(count):
        own = distortion * (rng.standard_normal((1, *G.shape[1:])) + 1j * rng.standard_normal((1, *G.shape[1:])))
        out.append(FrequencyResponse(F_HZ, noisy(rng, G * (1 + own), 1e-3).values))
    return out


def test_six_and_thirty_are_orthonormal_and_complete():
    rows = np.vstack(contrasts())
    assert np.allclose(rows @ rows.T, np.eye(36), atol=1e-12)


def test_six_functions_come_back_and_average(rng):
    plant = symmetric(rng)
    G = plant.frequency_response(F_HZ)
    loops = fold(noisy(rng, G, 1e-9)).loops
    T = transform()
    H = np.einsum("ai,abf,bj->ijf", T, G, T)
    for loop, place in zip(loops, ([0], [1], [2, 3]), strict=True):
        assert np.allclose(loop.values, H[np.ix_(place, place)], atol=1e-7)
    scatter = np.array(
        [[fold(noisy(rng, G, 0.1)).loops[k].values - loops[k].values for k in range(2)] for _ in range(60)]
    )
    ratio = np.mean(np.abs(scatter) ** 2) / 0.01
    spread = fold(noisy(rng, G, 0.1)).loops[2].variance
    print(f"\nvariance of a scalar loop {ratio:.2f} of one response's, sway and rock {np.mean(spread) / 0.01:.2f}")
    assert abs(ratio - 1.0) < 0.1  # of g_1, itself about six times one response
    assert np.allclose(spread, 0.005)


@pytest.mark.gate("variance")
@pytest.mark.draws(false_alarm=1.3e-3)  # binomial, 200 draws, three levels
@pytest.mark.parametrize("kind", ["variance", "realisations"])
def test_false_alarms_are_as_many_as_promised(kind, rng):
    G = symmetric(rng).frequency_response(F_HZ)
    make = (lambda: noisy(rng, G, 0.01)) if kind == "variance" else (lambda: realisations(rng, G))
    p = np.array([fold(make(), seed=k).p_value for k in range(DRAWS)])
    below = {level: float(np.mean(p < level)) for level in (0.5, 0.1, 0.01)}
    print(f"\n{kind}: " + ", ".join(f"p < {k}: {v:.1%}" for k, v in below.items()))
    assert abs(below[0.5] - 0.5) < 0.15
    assert abs(below[0.1] - 0.1) < 0.08
    assert below[0.01] < 0.04


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
def test_noise_that_is_alike_at_all_sensors_needs_the_realisations(rng):
    """The test with variances alone takes channels as independent; where they are not it may not be trusted."""
    G = symmetric(rng).frequency_response(F_HZ)
    several = realisations(rng, G)
    values = np.array([r.values for r in several])
    mean = FrequencyResponse(F_HZ, values.mean(axis=0), variance=values.var(axis=0, ddof=1) / len(values))
    print(f"\nwith variances p = {fold(mean).p_value:.2g}, with realisations p = {fold(several).p_value:.2g}")
    assert fold(several).status.ok


def test_a_strut_unlike_the_others_is_found(rng):
    G = symmetric(rng).frequency_response(F_HZ)
    G[:, 2] *= 1.1
    noise = 0.01 * float(np.sqrt(np.mean(np.abs(G[:, 2]) ** 2)))  # drawn plants are of all sizes
    for given in (noisy(rng, G, noise), realisations(rng, G)):
        found = fold(given)
        print(f"\n{found.status}")
        assert found.status.word == "not symmetric"


@pytest.mark.slow
def test_model_of_six_functions(rng):
    G = uq.bench.Hexapod(unit="flight").linear_response(F_HZ)
    fit = Threefold(StructuredModal()).identify_response(noisy(rng, G, 1e-4), RATE_HZ)
    H = fit.model.frequency_response(F_HZ)
    miss = np.linalg.norm(G - H, axis=(0, 1)) / np.linalg.norm(G, axis=(0, 1))
    modes = [loop.modes_hz.round(1).tolist() for loop in fit.loops]
    print(f"\nmodel of six functions misses 36 by {miss.max():.1%} at the worst line; modes {modes} Hz")
    assert miss.max() < 0.05
    assert uq.analyse.threefold_error(H).max() < 1e-10


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
@pytest.mark.parametrize("unit_seed", [0, 1])
def test_units_within_their_tolerances_are_told_from_the_drawing(unit_seed, rng):
    for spread, word in ((0.0, "ok"), (1.0, "not symmetric")):
        G = uq.bench.Hexapod(unit="ground", spread=spread, unit_seed=unit_seed).linear_response(F_HZ)
        found = fold(realisations(rng, G))
        print(f"\nspread {spread}: {found.status}", end="")
        assert found.status.word == word


def test_bad_responses_are_refused(rng):
    with pytest.raises(InputError, match="six struts"):
        fold(FrequencyResponse([1.0], np.ones((2, 2, 1))))
    G = symmetric(rng).frequency_response(F_HZ)
    with pytest.raises(InputError, match="too few"):
        fold(realisations(rng, G, count=2))
    with pytest.raises(InputError, match="same lines"):
        fold([FrequencyResponse(F_HZ, G), FrequencyResponse(F_HZ + 0.1, G)])
