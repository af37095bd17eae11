"""Records -> model -> bound of its error -> a design that stands the bound -> the true bench."""

import numpy as np
import pytest
from test_band_attenuation import judged, measured

import ultraquiet as uq
from ultraquiet.design import BandAttenuation
from ultraquiet.design.robust_stability import robust_stability
from ultraquiet.values import FrequencyResponse, StateSpace
from ultraquiet.values.interconnect import append, feedback, parallel, sensitivity

pytestmark = pytest.mark.slow
LOWEST_HZ = 3.0


@pytest.fixture(scope="module")
def identified(first_seed):
    """Return the model of the noisy bench, the weight on its relative error, and the bound."""
    response = measured(first_seed)
    fit = uq.identify.Rational(order=16, delay=2, zeros_at_dc=1).identify_response(response, 3500.0)
    # below, the transducers give so little that the records show their own noise; the weight goes on rising there
    heard = response.f_hz > LOWEST_HZ
    kept = FrequencyResponse(response.f_hz[heard], response.values[:, :, heard])
    bound = uq.validate.from_spread(fit.model, [kept])
    return fit.model, bound.weight(3500.0).system, bound


@pytest.fixture(scope="module")
def truth():
    return uq.bench.Hexapod(unit="ground").linear_model()


def relative_error(model, truth, f_hz):
    """Return (G_true - G) G^-1 at every frequency, written without the package's own bound."""
    G, T = (np.moveaxis(s.frequency_response(f_hz), 2, 0) for s in (model, truth))
    return (T - G) @ np.linalg.inv(G)


def largest(matrices):
    return np.linalg.norm(matrices, 2, axis=(1, 2))


def test_promise_of_robust_stability_holds_on_the_true_bench(identified, truth):
    model, W, bound = identified
    asked = BandAttenuation(
        band_hz=(9.0, 108.0),
        structure="repeated",
        uncertainty=W,
        control_limit=1000.0,
        control_hz=400.0,
        roll_off_hz=500.0,
    )
    result = asked.design(model)
    print(result.status)
    assert result.status.ok
    size = result.details["robust_stability"]
    full = append(*[W] * 6)
    assert size == pytest.approx(robust_stability(model, result.controller, full), rel=1e-6)
    assert size < 1
    assert result.details["height"] <= 12.0
    # the bound was drawn from records alone: does it cover the truth, and does the loop keep its promise?
    gains = np.abs(W.frequency_response(bound.f_hz)[0, 0])
    covered = np.mean(largest(relative_error(model, truth, bound.f_hz)) <= gains)
    S = sensitivity(model, result.controller)
    T = parallel(S, StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), -np.eye(6), 3500.0))
    f = np.concatenate([np.geomspace(0.3, LOWEST_HZ, 50), bound.f_hz])
    # of the product: at a zero of the model, in directions that T does not have, E alone has no bound
    seen = float(np.max(largest(relative_error(model, truth, f) @ np.moveaxis(T.frequency_response(f), 2, 0))))
    print(f"bound covers the true error at {covered:.1%} of the lines; promised {size:.3f}, true ||E T|| {seen:.3f}")
    assert covered > 0.98
    assert seen < 1
    assert feedback(truth, result.controller).is_stable()
    worst, peak = judged("designed for the uncertainty, true bench", truth, result.controller)
    assert worst > 8
    assert peak < 10
