"""Refits that begin from the last model, and starts that do not fit."""

import numpy as np
import pytest
from truths import draw

import ultraquiet as uq
from ultraquiet._base.errors import InputError


def test_a_refit_takes_a_fraction_of_the_steps(rng):
    """A fresh record of the same plant: same minimum, fewer steps over all starts' searches."""
    method = uq.identify.BoxJenkins(order=5)
    cold, warm = [], []
    for _ in range(12):
        before = method.identify(draw("suite_rate", rng).record)
        record = draw("suite_rate", rng).record
        fresh, refit = method.identify(record), method.identify(record, start=before.model)
        cold.append(fresh.iterations[0])
        warm.append(refit.iterations[0])
        # The race may end in a poorer minimum than the refit, never the other way round by more than chance.
        assert refit.loss[0] < 1.02 * fresh.loss[0]
        assert refit.details["starts"] == (1,)
    print(f"\nsteps: {np.mean(cold):.1f} from subspaces, {np.mean(warm):.1f} from the last model")
    print(f"a refit takes {np.mean(warm) / np.mean(cold):.2f} of the steps")
    assert np.mean(warm) < 0.5 * np.mean(cold)


def test_a_matrix_begins_from_the_last_one(rng):
    method = uq.identify.OutputError(order=1)
    u = rng.standard_normal((2, 1500))
    plant = [uq.PolynomialModel([[0.0, g]], [[1.0, -0.9]], 100.0).state_space() for g in (1.0, 0.5)]
    records = [
        uq.Record(x, [p.simulate(x[None])[0] + 0.1 * rng.standard_normal(x.size) for p in plant], 100.0) for x in u
    ]
    first = uq.identify.identify_matrix(method, records)
    again = uq.identify.identify_matrix(method, records, start=first.model)
    print(f"\nsteps {first.iterations.tolist()}, again on the same records {again.iterations.tolist()}")
    assert np.all(again.iterations <= 1)
    assert again.loss == pytest.approx(first.loss, rel=1e-3)


def test_a_smaller_model_is_a_start_for_a_larger_one(rng):
    record = draw("easy", rng).record
    smaller = uq.identify.BoxJenkins(order=4).identify(record)
    larger = uq.identify.BoxJenkins(order=5, focus="prediction").identify(record, start=smaller.model)
    print(f"\nloss of order 4 {smaller.loss[0]:.4g}, of order 5 from it {larger.loss[0]:.4g}")
    assert larger.loss[0] < smaller.loss[0]


@pytest.mark.parametrize("what", ["order", "rate", "channels", "structure"])
def test_starts_that_do_not_fit_are_refused(what, rng):
    u = rng.standard_normal(900)
    record = uq.Record(u, np.convolve(u, [0.0, 1.0, 0.5])[:900] + 0.1 * rng.standard_normal(900), 100.0)
    starts = {
        "order": [[uq.PolynomialModel([[0.0, 1.0]], [[1.0, 0.1, 0.1, 0.1]], 100.0)]],
        "rate": [[uq.PolynomialModel([[0.0, 1.0]], [[1.0, 0.1]], 50.0)]],
        "channels": [[uq.PolynomialModel([[0.0, 1.0]], [[1.0, 0.1]], 100.0)] * 2],
        "structure": [[uq.PolynomialModel([[0.0, 1.0]], [[1.0]], 100.0, a=[1.0, 0.2])]],
    }
    with pytest.raises(InputError, match="start"):
        uq.identify.BoxJenkins(order=2).identify(record, start=uq.PolynomialMatrix(starts[what]))
