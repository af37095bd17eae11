"""Prediction-error refinement of state space: gradients, maximum likelihood, poles that change from pairs to reals."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from truths import modal_truth

import ultraquiet as uq
from ultraquiet.identify.subspace import fit as state_fit
from ultraquiet.identify.subspace import gauss_newton, kernels
from ultraquiet.linalg import response

FIT, SHARE = 95.0, 0.01  # percent; of a mode's frequency


def point(rng, ny=2, inputs=3):
    """A pair, two reals, a single real pole, and a pair that is nearly two reals."""
    tau, sigma, kappa = np.array([0.9, 0.6, 0.5, 0.7]), np.array([0.2, 0.2, 0.0, 0.1]), np.array([-1.0, 1.0, 0.0, -0.3])
    b, c = rng.standard_normal((4, 2, inputs)), rng.standard_normal((ny, 4, 2))
    b[2, 1], c[:, 2, 1] = 0.0, 0.0
    return gauss_newton.BlockModel(tau, sigma, kappa, b, c, rng.standard_normal((ny, 2)), np.zeros((0, 0)))


def signals(rng, ny=2, inputs=3, n=300):
    drive = np.hstack([np.zeros((inputs, 1)), rng.standard_normal((inputs, n - 1))])
    return gauss_newton.Signals(drive, rng.standard_normal((2, n)), rng.standard_normal((ny, n)))


def errors(at, data):
    """The plain twin: the blocks simulated as one system, driven by the next sample of what comes one late."""
    A, B, C = at.matrices()
    ahead = np.hstack([data.drive[:, 1:], np.zeros((len(B.T), 1))])
    x0 = B @ data.drive[:, 0]
    said = response.simulate(A, B, C, np.zeros((len(C), len(B.T))), ahead, x0)
    return data.outputs - said - at.direct @ data.tail


def test_the_kernel_and_its_plain_twin(rng):
    at, data = point(rng), signals(rng, n=2 * kernels.MODAL_BLOCK + 100)
    e = errors(at, data)
    assert gauss_newton.evaluated(at, data).covariance == pytest.approx(e @ e.T, rel=1e-9)


@pytest.mark.parametrize("weighted", [True, False])
def test_the_gradient_is_that_of_finite_differences(weighted, rng):
    data = signals(rng)
    at = gauss_newton._even(gauss_newton.evaluated(point(rng), data))
    normal = gauss_newton._Normal(at, data, weighted)

    def loss(step):
        return gauss_newton._loss(gauss_newton.evaluated(normal.moved(step), data), data, weighted)

    size, wide = len(normal.right), normal.right_c.shape
    told, found, h = [], [], 1e-5
    for k in range(size + normal.right_c.size):
        step = np.zeros(size), np.zeros(wide)
        (step[0] if k < size else step[1].reshape(-1))[k if k < size else k - size] = h
        back = -step[0], -step[1]
        found.append((loss(step) - loss(back)) / (2 * h))
        told.append(-2.0 * (normal.right[k] if k < size else normal.right_c.reshape(-1)[k - size]))
    error = np.abs(np.array(told) - found).max() / np.abs(found).max()
    print(f"\ngradient of {len(told)} parameters, largest error {error:.1e} of the largest")
    assert error < 1e-5


@pytest.mark.slow
def test_six_by_six_of_order_thirty_reaches_the_bound(rng):
    plant, record, clean = modal_truth(rng)
    result = uq.identify.Subspace(order=30, horizon=90, feedthrough=False, refine=True).identify(record)
    fit = 100 * (
        1 - np.linalg.norm(clean - result.model.simulate(record.inputs), axis=1) / np.linalg.norm(clean, axis=1)
    )
    f = [np.abs(np.log(p)) for p in (plant.poles(), result.model.poles())]
    near = sum(np.abs(f[1] / one - 1).min() < SHARE for one in f[0]) // 2
    # each output has its share of the 15 (2 (6 + 6 + 1) - 2 + 2) numbers; noise of -30 dB
    bound = 100 * (1 - 10 ** (-30 / 20) * np.sqrt(15 * 24 / 6 / record.samples))
    print(
        f"\n6 x 6, 30 states: fit {fit.min():.2f} .. {fit.max():.2f} % (bound {bound:.2f}), {near} of 15, "
        f"{result.status}"
    )
    assert np.mean(fit) >= FIT
    assert np.mean(fit) >= bound - 0.05
    assert near == 15
    assert result.model.is_stable()


def coloured(rng, n=6000):
    """A pair and two real poles, noise through the same states."""
    A = np.array([[0.95, 0.2, 0, 0], [-0.2, 0.95, 0, 0], [0, 0, 0.9, 0], [0, 0, 0, 0.6]])
    B, C = rng.uniform(0.5, 1.5, (4, 2)), rng.uniform(0.5, 1.5, (2, 4)) * [[1, 1, 1, 1], [1, -1, 1, -1]]
    K = 0.3 * np.linalg.pinv(C)
    u, e = rng.standard_normal((2, n)), 0.3 * rng.standard_normal((2, n))
    y = response.simulate(
        A, np.hstack([B, K]), C, np.hstack([np.zeros((2, 2)), np.eye(2)]), np.vstack([u, e]), np.zeros(4)
    )
    return uq.Record(u, y, 200.0), e


@pytest.mark.draws(false_alarm=2e-3)  # a verdict of two tests at the level of a thousandth
def test_the_one_step_error_is_the_innovation(rng):
    record, e = coloured(rng)
    method = uq.identify.Subspace(order=4, feedthrough=False, refine=True, focus="prediction")
    result = method.identify(record)
    truth = np.mean(e**2, axis=1)
    print(f"\nloss over the truth's {(result.loss / truth).round(4)}, {result.status}")
    assert result.loss == pytest.approx(truth, rel=0.02)
    assert result.status.ok
    assert result.model.is_stable()
    assert result.model.is_invertible()
    missed = result.model.innovations(record)[:, 50:] - e[:, 50:]
    assert missed.std() < 0.1 * e.std()
    one, five = (uq.validate.compare(result.model, record, steps=k).fit_percent for k in (1, 5))
    simulated = uq.validate.compare(result.model, record).fit_percent
    print(f"fit one step ahead {one.round(1)}, five {five.round(1)}, simulated {simulated.round(1)} %")
    assert np.all(one > five)
    assert np.all(five > simulated)


def test_the_noise_model_of_the_simulation_focus_predicts_too(rng):
    record, e = coloured(rng)
    result = uq.identify.Subspace(order=4, feedthrough=False).identify(record)
    held = uq.validate.compare(result.model, record).fit_percent
    print(f"\nunrefined: loss over the truth's {(result.loss / np.mean(e**2, axis=1)).round(3)}")
    assert np.all(result.loss < 1.2 * np.mean(e**2, axis=1))
    assert np.all(uq.validate.compare(result.model, record, steps=1).fit_percent > held)


def test_a_pair_becomes_two_reals_on_the_way(rng):
    """The search begins at a pair and must end at two reals."""
    u = rng.standard_normal((1, 4000))
    A, B, C = np.diag([0.95, 0.7]), np.array([[1.0], [-1.0]]), np.array([[1.0, 0.8]])
    y = response.simulate(A, B, C, np.zeros((1, 1)), u, np.zeros(2)) + 0.05 * rng.standard_normal((1, 4000))
    start = state_fit.System(
        np.array([[0.85, 0.1], [-0.1, 0.85]]), np.ones((2, 1)), np.ones((1, 2)), *map(np.zeros, ((1, 1), (2, 1), 2, 1))
    )
    data = state_fit.Scaled(u, y, np.ones((1, 1)), np.ones((1, 1)))
    found, steps, done = state_fit.refined_simulation(start, data, state_fit.Options(False, False, True, 50))
    poles = np.sort(np.linalg.eigvals(found.A))
    print(f"\nfrom 0.85 +- 0.1j to {poles.round(4)} in {steps} steps")
    assert done
    assert np.isrealobj(poles)
    assert poles == pytest.approx([0.7, 0.95], abs=0.02)


def integrating(nu, ny, rng):
    """Return a record of an integrator and a damped pair, its noise as a share of what is without it, and `known_to`.

    That is the deviation of the integrator's pole p. With the walk x_j of each input, dy_i/dp = c_i sum_k b x_k; what a
    constant, the initial state (together they make a ramp of p^t) and the gains towards each walk can take of it tells
    nothing of p: 1 / sqrt(sum_i |rest_i|^2 / sigma_i^2).
    """
    A = np.asarray(block_diag([[1.0]], [[0.9, 0.3], [-0.3, 0.9]]))
    B, C = (rng.uniform(0.5, 1.0, shape) * rng.choice([-1.0, 1.0], shape) for shape in ((3, nu), (ny, 3)))
    B[0] *= 0.03
    plant = uq.StateSpace(A, 1e-3 * B, 1e-6 * C, np.zeros((ny, nu)), rate_hz=100.0)
    u = 1e3 * rng.standard_normal((nu, 2000))
    clean = plant.simulate(u)
    sigma = 0.05 * clean.std(axis=1, keepdims=True)
    noise = sigma * rng.standard_normal(clean.shape)
    share = np.linalg.norm(noise, axis=1) / np.linalg.norm(clean - clean.mean(axis=1)[:, None], axis=1)
    walks = np.cumsum(u, axis=1)
    taken = np.vstack([np.ones(2000), np.arange(2000), walks]).T
    rest = np.cumsum(plant.B[0] @ walks)
    rest -= taken @ np.linalg.lstsq(taken, rest, rcond=None)[0]
    known_to = 1 / np.linalg.norm(rest * plant.C[:, :1] / sigma)
    return uq.Record(u, clean + noise, 100.0), share, known_to


# Each channel is tested twice at a thousandth; beside an integrator 8 of 300 draws are not white or not converged.
BESIDE_AN_INTEGRATOR = pytest.param(
    uq.identify.PredictorSubspace(order=3), marks=pytest.mark.draws(false_alarm=0.05), id="predictor"
)


@pytest.mark.gate("3-4-predictor", "5-3-method0", "1-1-predictor")
@pytest.mark.draws(false_alarm=2e-3)  # a verdict of two tests at the level of a thousandth
@pytest.mark.parametrize("method", [uq.identify.Subspace(order=3, refine=True), BESIDE_AN_INTEGRATOR])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_an_integrator_is_refined_to_one(method, nu, ny, rng):
    """Noise draws its pole over the circle in one of two records; there no minimum lies inside."""
    record, share, known_to = integrating(nu, ny, rng)
    found, reached = method.identify(record), 100 * (1 - share)
    slowest = found.model.poles()[np.abs(found.model.poles()).argmax()]
    print(found.status, found.fit_percent - reached, (1 - slowest) / known_to)
    assert found.status.ok
    assert found.model.is_stable()
    assert abs(1 - slowest) < 4.5 * known_to
    np.testing.assert_allclose(found.fit_percent, reached, atol=0.1)


def test_a_pole_that_noise_draws_over_the_circle_is_kept_inside_at_no_loss():
    """Mirrored at the search's end alone it would stand away from every minimum: the loss here a tenth higher."""
    record, share, _ = integrating(5, 3, np.random.default_rng(902))
    found = uq.identify.PredictorSubspace(order=3).identify(record)
    noise = share**2 * record.outputs.var(axis=1)
    print(found.status, found.loss / noise)
    assert found.status.ok
    assert np.all(found.loss < 1.01 * noise)
