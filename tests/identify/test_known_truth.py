"""Known answers: what the search finds against the truth that made the record."""

import numpy as np
import pytest
from truths import draw

import ultraquiet as uq

TRUTH_FIT = 95.0  # median simulated fit to the noise-free output; 98 is attainable
SAME_LOSS, BAD_LOSS = 1.02, 1.05


def clean_fit(result, drawn):
    simulated = result.state_space().simulate(drawn.record.inputs)[0]
    return 100 * (1 - np.linalg.norm(drawn.clean - simulated) / np.linalg.norm(drawn.clean - drawn.clean.mean()))


def campaign(name, rng, count):
    method = uq.identify.BoxJenkins(order=5)
    drawn = [draw(name, rng) for _ in range(count)]
    results = [method.identify(d.record) for d in drawn]
    ratio = np.array([r.loss[0] / np.mean(d.innovations**2) for r, d in zip(results, drawn, strict=True)])
    fits = np.array([clean_fit(r, d) for r, d in zip(results, drawn, strict=True)])
    ok = np.array([r.status.ok for r in results])
    print(
        f"\n{name}: {count} records, fit median {np.median(fits):.2f} worst {fits.min():.2f} %, loss within 2 % of the "
        f"truth's in {np.mean(ratio < SAME_LOSS):.1%}, worst {ratio.max():.3f}, ok {ok.sum()}"
    )
    assert all(r.model.is_invertible() and r.model.is_stable() for r in results)
    assert not np.any(ok & (ratio > BAD_LOSS))
    return fits, ratio, ok


def test_box_jenkins_meets_the_truth_at_the_rate_of_suite(rng):
    fits, ratio, ok = campaign("suite_rate", rng, 20)
    assert np.median(fits) >= TRUTH_FIT
    assert np.mean(ratio < SAME_LOSS) >= 0.9
    # A verdict errs once in a thousand: three refusals of twenty good models would be no accident.
    assert ok.sum() >= 17


def test_box_jenkins_meets_the_easy_truth(rng):
    fits, ratio, _ = campaign("easy", rng, 10)
    assert np.median(fits) >= 99.0
    assert np.mean(ratio < SAME_LOSS) >= 0.8


@pytest.mark.slow
def test_starts_hold_over_two_hundred_records(rng):
    fits, ratio, ok = campaign("suite_rate", rng, 200)
    assert np.mean(ratio < SAME_LOSS) >= 0.98
    assert not np.any(ok & (ratio >= SAME_LOSS))
    assert np.median(fits) >= 97.0


def test_a_model_too_small_is_never_ok(rng):
    for order in (2, 3, 4):
        drawn = draw("suite_rate", rng)
        result = uq.identify.BoxJenkins(order=order).identify(drawn.record)
        excess = result.loss[0] / np.mean(drawn.innovations**2)
        print(f"\norder {order}: loss {excess:.2f} of the truth's, {result.status}")
        if excess > BAD_LOSS:
            assert result.status.word in ("not white", "not converged")


def test_zero_initial_conditions_inflate_the_loss(rng):
    drawn = draw("suite_rate", rng)
    fitted = uq.identify.BoxJenkins(order=5).identify(drawn.record).loss[0]
    rest = uq.identify.BoxJenkins(order=5, initial="rest").identify(drawn.record).loss[0]
    print(f"\ninitial conditions at rest: loss {rest / fitted:.2f} times the fitted one's")
    assert rest > fitted


def test_the_other_structures_find_their_own_truths(rng):
    n, rate_hz = 4096, 100.0
    u, e = rng.standard_normal((2, n))
    a, b, c = np.array([1.0, -1.6, 0.8]), np.array([0.0, 1.0, 0.5]), np.array([1.0, 0.7, 0.2])
    from scipy.signal import lfilter

    cases = {
        uq.identify.Arx(order=2): lfilter(b, a, u) + lfilter([1.0], a, 0.3 * e),
        uq.identify.Armax(order=2): lfilter(b, a, u) + lfilter(c, a, 0.3 * e),
        uq.identify.OutputError(order=2): lfilter(b, a, u) + 0.3 * e,
    }
    for method, y in cases.items():
        result = method.identify(uq.Record(u, y, rate_hz))
        model = result.model.rows[0][0]
        miss = np.abs(model.denominator(0) - a).max()
        print(f"\n{method.name}: denominator off by {miss:.4f}, loss {result.loss[0]:.4f}, {result.status.word}")
        assert miss < 0.02
        assert result.loss[0] == pytest.approx(0.09, rel=0.15)


# 1 of 200 records ends in another minimum and says so; of twelve, one draw in seventeen holds such a one.
@pytest.mark.draws(false_alarm=0.1)
def test_covariance_tells_the_spread_of_the_estimate(rng):
    method = uq.identify.BoxJenkins(order=5)
    pulls = []
    for _ in range(12):
        drawn = draw("suite_rate", rng)
        result = method.identify(drawn.record)
        m = result.model.rows[0][0]
        found = np.concatenate([m.b[0][1:], m.f[0][1:], m.c[1:], m.d[1:]])
        t = drawn.model
        true = np.concatenate([t.b[0][1:], t.f[0][1:], t.c[1:], t.d[1:]])
        pulls.append((found - true) / np.sqrt(np.diag(result.covariance[0])))
    rms = np.sqrt(np.mean(np.square(pulls)))
    print(f"\ncoefficients' errors are {rms:.2f} of their standard deviations (1 is right)")
    # 12 draws of about five independent groups of parameters: the ratio itself scatters by some 10 %.
    assert 0.6 < rms < 1.6


def test_a_delay_and_two_inputs(rng):
    from scipy.signal import lfilter

    u = rng.standard_normal((2, 4096))
    y = lfilter([0, 0, 0, 1.0], [1, -0.9], u[0]) + lfilter([0, 0, 0, 0.5], [1, 0.5], u[1])
    y += lfilter([1, 0.5], [1, -0.8], 0.1 * rng.standard_normal(4096))
    result = uq.identify.BoxJenkins(order=1, delay=3).identify(uq.Record(u, np.stack([y, -y]), 100.0))
    model = result.model.rows[0][0]
    print(
        f"\ntwo inputs: {result.status}; b {[p.round(3).tolist() for p in model.b]}, f {[p.round(3) for p in model.f]}"
    )
    assert result.model.frequency_response([0.0]).shape == (2, 2, 1)
    assert model.b[0] == pytest.approx([0, 0, 0, 1.0], abs=0.02)
    assert model.f[1] == pytest.approx([1, 0.5], abs=0.05)
    assert result.fit_percent.shape == (2,)


@pytest.mark.parametrize("focus", ["auto", "prediction", "simulation"])
@pytest.mark.parametrize(
    "without", [{"c_order": 0, "d_order": 0}, {"f_order": 0}, {"c_order": 0, "d_order": 0, "f_order": 0}]
)
def test_box_jenkins_does_without_any_of_its_polynomials(without, focus, rng):
    u, noise = rng.standard_normal((2, 2000))
    y = np.convolve(u, [0.0, 1.0, 0.5])[:2000] + 0.1 * noise
    result = uq.identify.BoxJenkins(order=2, focus=focus, **without).identify(uq.Record(u, y, 100.0))
    model = result.model.rows[0][0]
    assert model.b[0] == pytest.approx([0.0, 1.0, 0.5], abs=0.1)
    assert result.covariance.shape[1] == model.b[0].size - 1 + sum(p.size - 1 for p in (model.f[0], model.c, model.d))
