"""Systems joined by operators against the responses they must have, with names, units and rates kept or refused."""

import numpy as np
import pytest

import ultraquiet as uq

F_HZ = np.array([0.5, 3.0, 17.0, 44.0])


def system(seed, ny, nu, rate_hz=100.0, states=3, scale=1.0, wires=True):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    A = A if rate_hz else A - 2.0 * np.eye(states)
    B, C, D = rng.standard_normal((states, nu)), rng.standard_normal((ny, states)), rng.standard_normal((ny, nu))
    names = [uq.Channel(f"force {k}", "N") for k in range(nu)], [uq.Channel(f"speed {k}", "m/s") for k in range(ny)]
    return uq.StateSpace(A, B, scale * C, scale * D, rate_hz, *(names if wires else (None, None)))


def response(G):
    return np.moveaxis(G.frequency_response(F_HZ), 2, 0)


def near(got, expected):
    assert np.abs(response(got) - np.moveaxis(np.asarray(expected), 0, 0)).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
@pytest.mark.parametrize("rate_hz", [100.0, None])
@pytest.mark.parametrize("scale", [1.0, 1e9, 1e-9])
def test_operators_are_those_of_matrices(seed, ny, nu, rate_hz, scale):
    G, H = system(seed, ny, nu, rate_hz, scale=scale), system(seed + 7, ny, nu, rate_hz, scale=scale)
    g, h = response(G), response(H)
    near(G + H, g + h)
    near(G - H, g - h)
    near(-G, -g)
    near(2.5 * G, 2.5 * g)
    near(G * np.float64(2.5), 2.5 * g)
    near(G + 1.0, g + 1.0)
    K = system(seed + 9, nu, ny, rate_hz, wires=False)
    near(G @ K, g @ response(K))
    near(K * G, response(K) @ g)
    M = np.random.default_rng(seed).standard_normal((2, ny))
    near(M @ G, M @ g)
    near(G @ M.T[:nu, :1] if ny >= nu else G @ np.ones((nu, 1)), g @ (M.T[:nu, :1] if ny >= nu else np.ones((nu, 1))))
    mild = 0.1 / np.abs(g).max() * K
    near(G.feedback(mild), np.linalg.solve(np.eye(ny) - g @ response(mild), g))
    near(G.feedback(mild, sign=-1), np.linalg.solve(np.eye(ny) + g @ response(mild), g))
    both = response(G.append(H))
    near(G.append(H), both)
    assert np.array_equal(both[:, :ny, nu:], np.zeros_like(both[:, :ny, nu:]))
    assert np.abs(both[:, ny:, nu:] - h).max() <= 1e-12 * np.abs(h).max()


def test_names_and_units_follow():
    G, K = system(1, 2, 3), system(2, 3, 2, wires=False)
    assert (G + system(3, 2, 3)).sensors == G.sensors
    assert (K + G.feedback(K).rate_hz * 0).sensors == K.sensors
    assert (G @ K).sensors == G.sensors
    assert (G @ K).actuators == K.actuators
    assert (K @ G).actuators == G.actuators
    assert (system(4, 2, 3, wires=False) + G).sensors == G.sensors
    assert G.feedback(0.01 * K).actuators == G.actuators
    assert [c.name for c in G.append(K).sensors] == ["speed 0", "speed 1", "output 3", "output 4", "output 5"]


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda G: G + system(1, 2, 2, rate_hz=50.0), "50 Hz"),
        (lambda G: G @ system(1, 2, 2, rate_hz=None), "continuous"),
        (lambda G: G @ G, "differ in unit, 'force 0' in N and 'speed 0' in m/s"),
        (lambda G: G + system(1, 3, 2), "do not fit, 2 channels and 3"),
        (lambda G: G + "one", "takes a system, a number or a matrix, got str"),
        (lambda G: G @ np.ones((2, 2, 2)), "a number or a matrix"),
        (lambda G: G.feedback(np.ones((3, 2))), r"the controller is \(3, 2\)"),
        (lambda G: G.feedback(np.linalg.inv(G.D)), "no solution"),
        (lambda G: G.feedback(G), "differ in unit"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(act, words):
    with pytest.raises(uq.errors.InputError, match=words):
        act(system(5, 2, 2))


def test_every_model_gives_a_response_with_its_names():
    G = system(1, 2, 3)
    found = G.response(F_HZ)
    assert isinstance(found, uq.FrequencyResponse)
    assert (found.actuators, found.sensors) == (G.actuators, G.sensors)
    assert np.array_equal(found.values, G.frequency_response(F_HZ))
    one = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=100.0)
    matrix = uq.PolynomialMatrix([[one]], ["force"], ["speed"])
    assert matrix.response(F_HZ).sensors[0].name == "speed"
    assert np.array_equal(one.response(F_HZ).values, matrix.response(F_HZ).values)
