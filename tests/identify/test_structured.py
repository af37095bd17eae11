"""Eq. (10) fitted with its own symbols: values, deviations that cover, what the data cannot tell, and sentences."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.identify.grey_box import strut_equation as strut
from ultraquiet.identify.grey_box.strut import Structured
from ultraquiet.values import FrequencyResponse

RATE_HZ = 3500.0
DELAY = 2
# A strut of its own, unlike the nominal one and unlike the bench.
TRUTH = {
    "m_g": 0.013, "b_g": 0.9, "k_g": 70.0, "K": 82.0, "m_p": 0.07, "b_p": 16.0, "k_p": 4.4e6, "n": 1.7, "C": 2.4e-6,
    "C_M": 7e-6, "R_M": 380.0, "filter_hz": 950.0, "filter_damping": 0.68,
}  # fmt: skip
SOUGHT = ("b_g", "k_g", "K", "R_M")
DATA_SHEET = {s: v for s, v in TRUTH.items() if s not in SOUGHT}
DRAWS = 400
COVERAGE = (0.93, 0.97)


def response_of(value, f_hz, delay=DELAY):
    f = strut.factors(value)
    return strut.response_behind_hold(f.gain, 3, f.poles(), f_hz, RATE_HZ) * np.exp(
        -2j * np.pi * f_hz * (delay - 1) / RATE_HZ
    )


def measured(rng, noise=0.02, f_hz=None, value=TRUTH, delay=DELAY):
    f_hz = np.geomspace(2.0, 250.0, 150) if f_hz is None else f_hz
    G = response_of(value, f_hz, delay)
    deviation = noise * np.sqrt(np.mean(np.abs(G) ** 2)) * np.ones(f_hz.size)
    e = deviation * (rng.standard_normal(f_hz.size) + 1j * rng.standard_normal(f_hz.size)) / np.sqrt(2)
    return FrequencyResponse(f_hz, (G + e)[None, None], variance=(deviation**2)[None, None])


def exact_simulation(value, u):
    """The strut by its own route: cascaded differential equations, exactly held, the delay a shift."""
    from scipy.linalg import expm

    f = strut.factors(value)
    den = np.polymul(np.polymul(f.geophone, f.strut), f.filter)
    scale = 2 * np.pi * 200.0  # time in units of this keeps the companion form small
    a = den / scale ** np.arange(den.size)
    n = a.size - 1
    A = np.vstack([np.eye(n - 1, n, 1), -a[:0:-1]])
    B = np.eye(n)[:, -1:]
    C = np.zeros(n)
    C[3] = f.gain * scale ** (3 - n)
    held = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * scale / RATE_HZ)
    x, y = np.zeros(n), np.empty(u.size)
    for t, v in enumerate(np.concatenate([np.zeros(DELAY - 1), u])[: u.size]):
        y[t] = C @ x
        x = held[:n, :n] @ x + held[:n, n] * v
    return y


def test_model_is_the_differential_equation_held(rng):
    u = rng.standard_normal(800)
    f = strut.factors(TRUTH)
    fit = Structured(known=DATA_SHEET).identify_response(measured(rng, noise=1e-12), RATE_HZ)
    gap = np.abs(fit.model.simulate(u[None])[0] - exact_simulation(TRUTH, u)).max() / exact_simulation(TRUTH, u).std()
    print(f"\nstate space against the differential equation: {gap:.1e}, {f.poles().size} poles")
    assert gap < 1e-6


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
@pytest.mark.parametrize("delay", [DELAY, None])
def test_symbols_return_from_a_response(rng, delay):
    fit = Structured(known=DATA_SHEET, delay=delay).identify_response(measured(rng, noise=0.002), RATE_HZ)
    print("\n" + ", ".join(f"{s} off by {fit.parameters[s] / TRUTH[s] - 1:+.2%}" for s in SOUGHT))
    assert fit.status.ok, fit.status
    assert fit.delay == DELAY
    for s in SOUGHT:
        assert abs(fit.parameters[s] - TRUTH[s]) < 5 * fit.deviations[s]
        assert fit.deviations[s] < 0.05 * TRUTH[s]


@pytest.mark.draws(false_alarm=1e-3)  # of the test that the response is met to its noise
def test_what_cannot_be_told_is_said(rng):
    known = {s: TRUTH[s] for s in strut.FILTER}
    fit = Structured(known=known).identify_response(measured(rng, noise=1e-4), RATE_HZ)
    print(f"\n{fit.status}\n" + "\n".join(f"{c}: {c.relative_deviation:.2%}" for c in fit.combinations))
    assert fit.status.ok
    assert all(np.isinf(fit.deviations[s]) for s in strut.GEOPHONE + strut.STACK)
    assert len(fit.combinations) == 6  # eq. (10) has five poles and a gain
    assert "m_g" in fit.status.sentence
    truth = strut.quantities(TRUTH)
    for name, (value, deviation) in fit.quantities.items():
        assert abs(value - truth[name]) <= max(5 * deviation, 1e-9 * value), name
    told = [c for c in fit.combinations if set(c.powers) <= {"m_g", "b_g", "k_g"}]
    assert len(told) == 2  # the geophone's mass is a free scale


def test_a_combination_is_told_even_where_its_symbols_are_not(rng):
    known = {s: v for s, v in TRUTH.items() if s not in ("m_g", "k_g")} | {"b_g": TRUTH["b_g"]}
    fit = Structured(known=known).identify_response(measured(rng, noise=1e-3), RATE_HZ)
    assert np.isfinite(list(fit.deviations.values())).all()  # b_g known settles the scale
    fit = Structured(known={s: v for s, v in known.items() if s != "b_g"}).identify_response(
        measured(rng, noise=1e-3), RATE_HZ
    )
    assert np.isinf([fit.deviations[s] for s in ("m_g", "b_g", "k_g")]).all()
    assert all(abs(sum(c.powers.values())) < 1e-3 for c in fit.combinations)  # quotients alone


def recorded(rng, noise=0.005, samples=4096):
    """A record that begins in the middle of a run, with coloured noise."""
    from scipy.signal import lfilter

    u = rng.standard_normal(samples + 500)
    y = exact_simulation(TRUTH, u)
    e = lfilter([1.0, 0.5], [1.0, -0.9], rng.standard_normal(u.size))
    y = y + noise * y.std() * e / e.std()
    return uq.Record(u[None, 500:], y[None, 500:], RATE_HZ)


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
def test_symbols_return_from_a_record(rng):
    result = Structured(known=DATA_SHEET).identify(recorded(rng))
    fit = result.details["fit"]
    off = {s: (fit.parameters[s] - TRUTH[s]) / fit.deviations[s] for s in SOUGHT}
    print(
        f"\n{result.status}, fit {result.fit_percent[0]:.1f} %\n" + ", ".join(f"{s} {v:+.1f} s" for s, v in off.items())
    )
    assert result.status.ok
    assert result.fit_percent[0] > 95
    assert max(map(abs, off.values())) < 5
    assert all(fit.deviations[s] < 0.05 * TRUTH[s] for s in ("K", "R_M"))


# Four symbols that move together: the shares of eight campaigns lie at 93.6 % with a deviation of 1.2 %, the noise of a
# record being read off its residual.
@pytest.mark.slow
@pytest.mark.draws(false_alarm=0.3)
def test_deviations_of_symbols_cover_from_records(rng):
    inside = dict.fromkeys(SOUGHT, 0)
    for _ in range(DRAWS // 2):
        fit = Structured(known=DATA_SHEET).identify(recorded(rng)).details["fit"]
        for s in SOUGHT:
            inside[s] += abs(fit.parameters[s] - TRUTH[s]) < 1.96 * fit.deviations[s]
    share = {s: 2 * k / DRAWS for s, k in inside.items()}
    mean = 2 * sum(inside.values()) / (DRAWS * len(SOUGHT))
    each = ", ".join(f"{s} {v:.1%}" for s, v in share.items())
    print(f"\n95 % intervals over {DRAWS // 2} records: {mean:.1%} ({each})")
    assert COVERAGE[0] <= mean <= COVERAGE[1]


# Of six campaigns at 94.9 % with a deviation of 1.1 %.
@pytest.mark.slow
@pytest.mark.draws(false_alarm=0.07)
def test_deviations_of_symbols_cover_from_responses(rng):
    inside = dict.fromkeys(SOUGHT, 0)
    for _ in range(DRAWS):
        fit = Structured(known=DATA_SHEET).identify_response(measured(rng), RATE_HZ)
        for s in SOUGHT:
            inside[s] += abs(fit.parameters[s] - TRUTH[s]) < 1.96 * fit.deviations[s]
    share = {s: k / DRAWS for s, k in inside.items()}
    mean = float(np.mean(list(share.values())))
    print(f"\n95 % intervals over {DRAWS} draws: {mean:.1%} ({', '.join(f'{s} {v:.1%}' for s, v in share.items())})")
    assert COVERAGE[0] <= mean <= COVERAGE[1]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Structured(known={"mass": 1.0}), "eq. \\(10\\) does not have"),
        (lambda: Structured(guess={"k_q": 1.0}), "its symbols are"),
        (lambda: Structured(guess={"k_g": 5.0}, bounds={"k_g": (10.0, 100.0)}), "between 10 and 100"),
        (lambda: Structured(known={"k_g": 5.0}, bounds={"k_g": (10.0, 100.0)}), "between 10 and 100"),
        (lambda: Structured(guess={"m_p": -1.0}), "above zero"),
        (lambda: Structured(bounds={"m_p": (2.0, 1.0)}), "rise"),
        (lambda: Structured(known=dict(strut.NOMINAL)), "nothing is left"),
    ],
)
def test_settings_are_refused_in_a_sentence(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def test_data_are_refused_in_a_sentence(rng):
    method = Structured(known=DATA_SHEET)
    high = measured(rng, f_hz=np.linspace(40.0, 250.0, 100))
    with pytest.raises(InputError, match="above the geophone's suspension"):
        method.identify_response(high, RATE_HZ)
    with pytest.raises(InputError, match="too few"):
        method.identify_response(measured(rng, f_hz=np.array([2.0, 5.0, 10.0])), RATE_HZ)
    with pytest.raises(InputError, match="half of it"):
        method.identify_response(measured(rng), 300.0)
    with pytest.raises(InputError, match="no line of"):
        method.identify_response(measured(rng, f_hz=np.linspace(400.0, 900.0, 50)), RATE_HZ)
    u = rng.standard_normal((6, 2000))
    with pytest.raises(InputError, match="one actuator to one sensor"):
        method.identify(uq.Record(u, u, RATE_HZ))
    G = np.ones((2, 1, 50), dtype=complex)
    with pytest.raises(InputError, match="one strut"):
        method.identify_response(FrequencyResponse(np.linspace(1, 200, 50), G), RATE_HZ)


def test_without_the_low_band_a_known_geophone_helps(rng):
    known = {s: v for s, v in TRUTH.items() if s not in ("K", "R_M")}
    fit = Structured(known=known).identify_response(measured(rng, f_hz=np.linspace(40.0, 250.0, 100)), RATE_HZ)
    assert fit.status.ok
    assert abs(fit.parameters["R_M"] / TRUTH["R_M"] - 1) < 0.05
