"""Slips of a caller: a result where a model is wanted is taken for it, anything else is refused in one sentence."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError

V = uq.validate


class Given:
    """A lag, a record of it, and what is identified from that."""

    def __init__(self):
        u, e = np.random.default_rng(1).standard_normal((2, 1000))
        self.model = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=10.0)
        self.record = uq.Record(u, self.model.state_space().simulate(u[None]) + 0.1 * e, 10.0)
        self.result = uq.identify.OutputError(order=1).identify(self.record)
        self.subspace = uq.identify.Subspace(order=1, refine=True).identify(self.record)


@pytest.fixture(scope="module")
def given():
    return Given()


def test_a_result_stands_for_its_model(given):
    result, model, record = given.result, given.result.model, given.record
    assert np.array_equal(V.compare(result, record).outputs, V.compare(model, record).outputs)
    assert np.array_equal(V.residual_test(result, record).residuals, V.residual_test(model, record).residuals)
    assert np.array_equal(V.innovations(result, record), V.innovations(model, record))
    assert V.advise(record, result) == V.advise(record, model)
    assert V.bode_agreement(result, model, (0.1, 4.0)).worst_gain_db[0, 0] < 1e-9
    assert V.from_spread(result, [given.subspace], [1.0]).radius[0] > 0.0
    band = V.state_space_band(given.subspace, record, [1.0])
    assert np.array_equal(band.values, V.state_space_band(given.subspace.model, record, [1.0]).values)
    again = uq.identify.OutputError(order=1).identify(record, start=result)
    assert again.fit_percent == pytest.approx(result.fit_percent, abs=1e-3)


SLIPS = {
    "a state space has no noise": (
        lambda g: V.residual_test(g.subspace.state_space(), g.record),
        "residual_test: 'model' must be a PolynomialMatrix or a PolynomialModel, got",
    ),
    "no model": (lambda g: V.compare(None, g.record), "compare: 'model' must be .* got NoneType"),
    "no record": (lambda g: V.compare(g.model, None), "compare: 'record' must be a Record, got NoneType"),
    "swapped": (lambda g: V.compare(g.record, g.model), "compare: 'model' must be .* got Record"),
    "model for result": (lambda g: V.response_band(g.model, [1.0]), "response_band: 'result' .* got PolynomialModel"),
    "model to draw": (lambda g: V.drawn_plants(g.model, 3), "drawn_plants: 'result' .* got PolynomialModel"),
    "model for loss": (lambda g: V.information_criteria(g.model, g.record), "its loss, got PolynomialModel"),
    "unnamed": (lambda g: V.select([g.result], g.record), "select: 'results' must be results by name"),
    "one other": (lambda g: V.from_spread(g.model, g.model, [1.0]), "'others' must be a list of models"),
    "nothing other": (lambda g: V.from_spread(g.model, [None], [1.0]), "'others' must be a model.* got NoneType"),
    "no lines": (lambda g: V.response_band(g.result, []), "response_band: 'f_hz' holds no frequencies"),
    "no lines to agree on": (lambda g: V.bode_agreement(g.model, g.model, f_hz=[]), "'f_hz' holds no frequencies"),
    "no lines to bound": (lambda g: V.from_covariance(g.result, []), "from_covariance: 'f_hz' holds no frequencies"),
    "three ends": (lambda g: V.bode_agreement(g.model, g.model, [1, 2, 3]), "lowest and the highest frequency, got 3"),
    "seed of a band": (
        lambda g: V.response_band(g.result, [1.0], method="sampled", seed=-1),
        "'seed' must be at least 0",
    ),
    "seed of a bound": (lambda g: V.from_covariance(g.result, [1.0], seed=-1), "'seed' must be at least 0"),
    "seed of plants": (lambda g: V.drawn_plants(g.result, 3, seed=-1), "'seed' must be at least 0"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_refused_in_one_sentence(slip, given):
    call, sentence = SLIPS[slip]
    with pytest.raises(InputError, match=sentence):
        call(given)
