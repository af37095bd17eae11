"""What an adaptive law does when its model is wrong, its readings are rubbish or its limits too small."""

from dataclasses import fields

import numpy as np
import pytest
from tone_runs import run, seconds, tone

import ultraquiet as uq
from ultraquiet.design import AdaptiveFeedforward, FilteredXLms, YoulaKucera
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values import StateSpace

METHODS = [AdaptiveFeedforward(tones_hz=(25.0,)), YoulaKucera(tones_hz=(25.0,)), FilteredXLms(reference=(5,), taps=64)]


def named(method):
    return type(method).__name__


@pytest.fixture(scope="module")
def ground():
    return uq.bench.Hexapod(unit="ground").linear_model()


@pytest.mark.gate("AdaptiveFeedforward")
@pytest.mark.parametrize("method", METHODS, ids=named)
def test_a_model_of_the_wrong_sign_brings_the_law_to_rest(method, ground, seed, rng):
    wrong = StateSpace(ground.A, -ground.B, ground.C, ground.D, ground.rate_hz, ground.actuators)
    law = method.design(wrong).law
    d = tone(rng, np.full(seconds(5.0).size, 25.0))
    closed = run(uq.bench.Hexapod(seed=seed), d, law)
    print(f"{law.status}")
    assert np.abs(closed.inputs).max() <= ground.actuators[0].high
    assert law.status.word == "diverged"
    assert "louder than at rest" in law.status.sentence
    assert not closed.inputs[:, -3500:].any()
    law.reset()
    assert law.status.ok


def small(method, seed, **settings):
    """Return the law for a plant of two channels at 1 kHz."""
    given = {f.name: getattr(method, f.name) for f in fields(method)} | {"limit": 10.0} | settings
    if isinstance(method, FilteredXLms):
        given["reference"] = (1,)
    return type(method)(**given).design(damped_plant(seed)).law


@pytest.mark.gate(
    "AdaptiveFeedforward-nan-None",
    "AdaptiveFeedforward-inf-None",
    "AdaptiveFeedforward-1e+300-None",
    "YoulaKucera-nan-None",
    "YoulaKucera-inf-None",
    "YoulaKucera-1e+300-None",
    "FilteredXLms-nan-None",
    "FilteredXLms-inf-None",
    "FilteredXLms-1e+300-None",
    "AdaptiveFeedforward-nan-lqg",
    "YoulaKucera-nan-lqg",
    "FilteredXLms-nan-lqg",
)
@pytest.mark.parametrize("around", [None, "lqg"])
@pytest.mark.parametrize("rubbish", [np.nan, np.inf, 1e300, 1e5])
@pytest.mark.parametrize("method", METHODS, ids=named)
def test_rubbish_never_leaves(method, rubbish, around, seed):
    law = small(method, seed, around=around)
    y = 0.3 * np.sin(2 * np.pi * 25 * np.arange(1400) / 1000) * np.ones((2, 1))
    y[1, 700:703] = rubbish
    u = np.array([law.step(y[:, k]) for k in range(y.shape[1])])
    assert np.isfinite(u).all()
    if not abs(rubbish) < 1e100:
        assert law.status.word == "diverged"
        # a hundred steps to rest, from the level at which the ramp began: the law may have been on its way already
        assert np.abs(np.diff(u[699:703], axis=0)).max() <= np.abs(u[600:700]).max() / 100 * 1.01
        if not around:
            assert not u[-1].any()


@pytest.mark.parametrize("method", METHODS, ids=named)
def test_reset_forgets_everything(method, seed, rng):
    law = small(method, seed)
    y = rng.standard_normal((300, 2))
    first = np.array([law.step(row) for row in y])
    law.reset()
    np.testing.assert_array_equal(first, np.array([law.step(row) for row in y]))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=named)
def test_a_limit_too_small_for_the_tone_is_said_and_kept(method, ground, seed, rng):
    settings = {f.name: getattr(method, f.name) for f in fields(method)}
    law = type(method)(**{**settings, "limit": 0.2}).design(ground).law
    d = tone(rng, np.full(seconds(5.0).size, 25.0))
    opened, closed = run(uq.bench.Hexapod(seed=seed), d), run(uq.bench.Hexapod(seed=seed), d, law)
    got = 20 * np.log10(opened.outputs[:, -3500:].std() / closed.outputs[:, -3500:].std())
    print(f"{named(method)} within 0.2 V: {got:.2f} dB, {law.status}")
    assert np.abs(closed.inputs).max() <= 0.2 + 1e-12
    assert law.status.word in ("limited", "ok")
    assert got > -1


@pytest.mark.parametrize(("y_unit", "u_unit"), [(1e9, 1.0), (1e-9, 1e6), (1.0, 1e-9)])
@pytest.mark.parametrize("method", METHODS, ids=named)
def test_a_law_learns_the_same_in_any_units(method, seed, y_unit, u_unit):
    """What is too faint to learn from follows from the plant and the actuators' limits, not from volts."""
    plant = damped_plant(seed)
    other = StateSpace(plant.A, plant.B / u_unit, y_unit * plant.C, plant.D * (y_unit / u_unit), plant.rate_hz)
    given = {f.name: getattr(method, f.name) for f in fields(method)}
    given |= {"reference": (1,)} if isinstance(method, FilteredXLms) else {}
    laws = [
        type(method)(**given | {"limit": limit}).design(model).law
        for model, limit in ((plant, 10.0), (other, 10.0 * u_unit))
    ]
    y = 1e-3 * np.sin(2 * np.pi * 25 * np.arange(1400) / 1000) * np.array([[1.0], [0.7]])
    first, second = (
        np.array([law.step(unit * row) for row in y.T]) for law, unit in zip(laws, (1.0, y_unit), strict=True)
    )
    assert np.abs(first).max() > 0
    assert np.abs(second / u_unit - first).max() < 1e-6 * np.abs(first).max()
