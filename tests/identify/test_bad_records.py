"""Bad data never yields a model: each refusal is one sentence that names the culprit."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError, RateError

METHODS = [
    uq.identify.Arx(order=2),
    uq.identify.Armax(order=2),
    uq.identify.OutputError(order=2),
    uq.identify.BoxJenkins(order=2),
    uq.identify.Subspace(order=2, horizon=5),
]


@pytest.fixture(params=METHODS, ids=lambda m: m.name)
def method(request):
    return request.param


@pytest.mark.parametrize("level", [0.0, 3.0])
def test_a_constant_input_is_refused(method, level, rng):
    record = uq.Record(np.full(2000, level), rng.standard_normal(2000), 100.0, actuators=["strut 3"])
    with pytest.raises(InputError, match=r"input 'strut 3' is constant at"):
        method.identify(record)


def test_a_steady_tone_is_refused(rng):
    tone = np.sin(2 * np.pi * 60 * np.arange(4096) / 3500)
    for order in (2, 5):
        with pytest.raises(InputError, match=r"input 'input 1' holds spectral lines for about 2 parameters"):
            uq.identify.BoxJenkins(order=order).identify(uq.Record(tone, rng.standard_normal(4096), 3500.0))


def struck(samples, rate_hz, blows, rng):
    """A lightly damped plant of one mode struck at each input once, `blows` samples after the start."""
    p = 0.98 * np.exp(0.3j)
    plant = uq.StateSpace(
        [[p.real, p.imag], [-p.imag, p.real]],
        np.vstack([np.ones(len(blows)), 0.3 * np.arange(len(blows))]),
        [[1.0, 0.0], [0.5, 1.0]],
        np.zeros((2, len(blows))),
        rate_hz,
    )
    u = np.zeros((len(blows), samples))
    u[np.arange(len(blows)), blows] = 1.0
    y = plant.simulate(u)
    return plant, uq.Record(u, y + 1e-3 * rng.standard_normal(y.shape), rate_hz)


@pytest.mark.parametrize("at", [3, 20, 512, 900])
@pytest.mark.parametrize("samples", [1000, 1024])
def test_a_blow_excites_as_much_at_the_beginning_as_in_the_middle(rng, at, samples):
    plant, record = struck(samples, 100.0, [at], rng)
    lines = np.geomspace(1.0, 45.0, 30)
    G = plant.frequency_response(lines)
    for method in (uq.identify.OutputError(order=2), uq.identify.Subspace()):
        found = method.identify(record)
        print(method.name, found.status, found.fit_percent)
        assert found.fit_percent.min() > 90.0
        assert np.abs(found.model.frequency_response(lines) - G).max() < 0.05 * np.abs(G).max()


def test_several_inputs_may_be_struck_at_the_beginning(rng):
    plant, record = struck(1000, 3500.0, [3, 330, 660], rng)
    found = uq.identify.Subspace().identify(record).model
    lines = np.geomspace(20.0, 1500.0, 30)
    G = plant.frequency_response(lines)
    assert np.abs(found.frequency_response(lines) - G).max() < 0.05 * np.abs(G).max()


@pytest.mark.parametrize("grown", [0.0, -0.01, 0.01])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_tone_that_dies_or_grows_is_no_blow(rng, grown, phase):
    t = np.arange(1000)
    tone = np.exp(grown * t) * np.sin(0.6 * t + phase)
    record = uq.Record(tone / np.abs(tone).max(), rng.standard_normal((3, 1000)), 100.0)
    with pytest.raises(InputError, match=r"input 'input 1' holds spectral lines for about \d+ parameters"):
        uq.identify.OutputError(order=8).identify(record)


def test_a_dead_sensor_is_refused(method, rng):
    record = uq.Record(rng.standard_normal(2000), np.zeros(2000), 100.0, sensors=["geophone 2"])
    with pytest.raises(InputError, match=r"output 'geophone 2' is constant at 0"):
        method.identify(record)


def test_a_short_record_is_refused_with_the_length_that_would_do(method, rng):
    with pytest.raises(InputError, match=r"record has 15 samples|needs at least 40 samples") as caught:
        method.identify(uq.Record(rng.standard_normal(15), rng.standard_normal(15), 100.0))
    needed = max(int(word) for word in str(caught.value).replace(",", " ").replace(";", " ").split() if word.isdigit())
    method.identify(uq.Record(rng.standard_normal(needed), rng.standard_normal(needed), 100.0))


def test_a_record_with_nan_is_refused(rng):
    u = rng.standard_normal(100)
    u[7] = np.nan
    with pytest.raises(InputError, match=r"NaN or infinite"):
        uq.Record(u, u, 100.0)


@pytest.mark.parametrize("make", [uq.identify.Arx, uq.identify.Armax, uq.identify.OutputError, uq.identify.BoxJenkins])
@pytest.mark.parametrize(
    "settings",
    [{"order": 2.5}, {"order": 0}, {"delay": -1}, {"order": True}, {"initial": "zero"}, {"max_iterations": 0}],
    ids=str,
)
def test_bad_settings_are_refused(make, settings):
    name = next(iter(settings))
    with pytest.raises(InputError, match=f"{make.__name__}: '{name}' must be"):
        make(**settings)


def two_records(rng):
    u = np.zeros((2, 2, 500))
    u[0, 0], u[1, 1] = rng.standard_normal((2, 500))
    return [uq.Record(u[k], rng.standard_normal((2, 500)), 100.0) for k in range(2)]


def test_records_in_the_wrong_order_are_refused(rng):
    with pytest.raises(InputError, match=r"record 1 must excite 'input 1' alone, it excites 'input 2'"):
        uq.identify.identify_matrix(uq.identify.Arx(order=1), two_records(rng)[::-1])


def test_records_of_two_rates_are_refused(rng):
    first, second = two_records(rng)
    second = uq.Record(second.inputs, second.outputs, 200.0)
    with pytest.raises(RateError, match=r"record 1 is sampled at 100 Hz but record 2 is sampled at 200 Hz"):
        uq.identify.identify_matrix(uq.identify.Arx(order=1), [first, second])


def test_no_records_are_refused():
    with pytest.raises(InputError, match=r"no records"):
        uq.identify.identify_matrix(uq.identify.Arx(order=1), [])


def test_records_are_left_as_they_are(rng):
    record = uq.Record(rng.standard_normal(500), rng.standard_normal(500), 100.0)
    before = record.hash
    for method in METHODS:
        method.identify(record)
    assert record.hash == before


@pytest.mark.parametrize(
    "weighing",
    [uq.identify.Subspace(order=2, horizon=5, refine=True), uq.identify.PredictorSubspace(order=2)],
    ids=lambda m: m.name,
)
def test_outputs_that_follow_from_each_other_are_refused_where_their_errors_are_weighed(weighing, rng):
    u, noise = rng.standard_normal((2, 2000))
    y = np.convolve(u, [0.0, 1.0, 0.5])[:2000] + 0.1 * noise
    other = y + rng.standard_normal(2000)
    for outputs, named in (([y, 2 * y, other], "'a', 'b'"), ([y, other, y - other], "'a', 'b', 'c'")):
        record = uq.Record(u, np.vstack(outputs), 100.0, sensors=["a", "b", "c"])
        with pytest.raises(InputError, match=f"outputs {named} follow from each other.*record.pick"):
            weighing.identify(record)
        assert uq.identify.Subspace(order=2, horizon=5).identify(record).fit_percent[0] > 80
