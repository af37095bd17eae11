"""With an uncertainty, peak and attenuation are those of every plant in it; demands may be shapes over frequency."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, band, modal, rectangular, responses

from ultraquiet._base.errors import InputError
from ultraquiet.design import Lqg
from ultraquiet.limits import Limit, best_flat_attenuation, by_direction, distance
from ultraquiet.limits.by_direction import tightened
from ultraquiet.limits.certificate import disc_of_every_plant
from ultraquiet.limits.programme import Demand, largest_sensitivity
from ultraquiet.values import StateSpace, Status, StatusWord
from ultraquiet.values.interconnect import append, feedback, series

LAG = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
BETWEEN_POINTS = 1.01  # a demand holds on a grid four times as fine as the programme's, to a hundredth


@pytest.mark.parametrize("error", [0.01, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("peak", [0.02, 0.7, 1.0, 1.9, 20.0])
def test_the_disc_holds_every_sensitivity_and_no_more(rng, peak, error):
    centre, radius = (float(x[0]) for x in disc_of_every_plant(np.array([peak]), np.array([error])))
    near = max(abs(radius), 0.1) * np.sqrt(rng.uniform(0, 2, 20_000)) * np.exp(2j * np.pi * rng.uniform(0, 1, 20_000))
    S = np.concatenate([centre + near, np.linspace(-peak, peak + 1, 4001)])
    allowed = S[largest_sensitivity(S, np.full(S.size, error)) <= peak]
    if radius < 0:
        assert not allowed.size
        return
    assert np.all(np.abs(allowed - centre) <= radius + 1e-12)
    for end in (centre - radius, centre + radius):  # at the demand: no smaller disc about a real point will do
        assert abs(end) + error * peak * abs(1 - end) == pytest.approx(peak, rel=1e-9, abs=1e-12)


@pytest.mark.gate("stable")
@pytest.mark.parametrize("growth", [1.0, 1.03], ids=["stable", "unstable"])
def test_its_controller_keeps_the_demands_on_every_plant(rng, growth):
    plant, quiet, error = modal(rng, growth=growth), band(rng), 0.15
    limit = best_flat_attenuation(plant, quiet, 6.0, control_gain=50.0, uncertainty=error, basis=30)
    print(f"{quiet}: {limit.status}")
    if not limit.status.ok:
        assert limit.status.word == "not certified" or growth > 1  # doing nothing keeps the demands of a stable plant
        return
    assert limit.attenuation_db <= limit.bound_db
    f = np.unique(np.concatenate([rng.uniform(0.01, RATE_HZ / 2, 2000), rng.uniform(*quiet, 500)]))
    S = 1 / (1 - plant.frequency_response(f)[0, 0] * limit.controller.frequency_response(f)[0, 0])
    inside = (f >= quiet[0]) & (f <= quiet[1])
    off = error * np.exp(2j * np.pi * rng.uniform(0, 1, (200, f.size))) * rng.uniform(0, 1, (200, 1)) ** 0.2
    every = np.abs(S / (1 + off * (1 - S)))
    worst_db, peak_db = -20 * np.log10(every[:, inside].max()), 20 * np.log10(every.max())
    print(
        f"drawn plants: {worst_db:.2f} dB of {limit.attenuation_db:.2f}, peak {peak_db:.2f} of {limit.peak_db:.2f} dB"
    )
    assert worst_db >= min(limit.attenuation_db, 60.0) - 0.1
    assert peak_db <= 6.0 + 20 * np.log10(BETWEEN_POINTS)


def test_real_plants_within_the_uncertainty_are_stable_and_quiet(rng):
    """An error is a system: an all-pass of any corner times the size of the error, either sign."""
    quiet, error = (10.0, 50.0), 0.3
    limit = best_flat_attenuation(LAG, quiet, 6.0, control_gain=20.0, uncertainty=error, basis=30, certify=False)
    f = np.unique(np.concatenate([np.linspace(0.1, RATE_HZ / 2, 2000), np.linspace(*quiet, 400)]))
    inside = (f >= quiet[0]) & (f <= quiet[1])
    worst, peak = 0.0, 0.0
    for corner in rng.uniform(-0.999, 0.999, 30):
        size = error * rng.choice([-1.0, 1.0])
        off = StateSpace([[corner]], [[1 - corner**2]], [[size]], [[-size * corner]], rate_hz=RATE_HZ)
        one = StateSpace(off.A, off.B, off.C, off.D + 1, RATE_HZ)
        true = series(LAG, one)
        assert feedback(true, limit.controller).is_stable()
        S = responses(true, limit.controller, f)[0]
        worst, peak = max(worst, S[inside].max()), max(peak, S.max())
    print(f"{limit.attenuation_db:.2f} dB promised, {-20 * np.log10(worst):.2f} dB worst; {20 * np.log10(peak):.2f} dB")
    assert -20 * np.log10(worst) >= limit.attenuation_db - 0.1
    assert 20 * np.log10(peak) <= 6.0 + 20 * np.log10(BETWEEN_POINTS)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e9])
def test_more_uncertainty_leaves_less(unit):
    plant = StateSpace(LAG.A, LAG.B, unit * LAG.C, LAG.D, RATE_HZ)
    found = [
        best_flat_attenuation(plant, (20.0, 100.0), 6.0, control_gain=10.0 / unit, uncertainty=e, basis=30)
        for e in (None, 0.05, 0.1, 0.3)
    ]
    print([f"{limit.attenuation_db:.2f} of {limit.bound_db:.2f} dB" for limit in found])
    for more, less in zip(found[1:], found, strict=False):
        assert more.attenuation_db < less.attenuation_db
        assert more.bound_db < less.bound_db
    assert all(limit.attenuation_db <= limit.bound_db for limit in found)


def test_a_plant_that_may_be_off_by_itself_is_surely_quiet_nowhere():
    table = ([10.0, 50.0, 60.0], [0.1, 0.1, 1.2])
    assert best_flat_attenuation(LAG, (20.0, 50.0), control_gain=10.0, uncertainty=table, basis=25).status.ok
    refused = best_flat_attenuation(LAG, (20.0, 60.0), control_gain=10.0, uncertainty=table, basis=25)
    print(refused.status)
    assert refused.status.word == "refused"
    assert "no controller makes every such plant quieter" in refused.status.sentence


def test_an_uncertainty_that_leaves_no_controller_is_named():
    unstable = StateSpace([[1.2]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    asked = {"peak_db": 8.0, "control_gain": 100.0, "basis": 25}
    assert best_flat_attenuation(unstable, (5.0, 20.0), **asked, certify=False).status.ok
    limit = best_flat_attenuation(unstable, (5.0, 20.0), **asked, uncertainty=0.8)
    print(limit.status)
    assert limit.status.word == "refused"
    assert "uncertainty" in limit.status.sentence


def test_where_nothing_is_asked_nothing_is_broken_even_by_a_plant_that_may_be_unstable():
    error = np.full(3, 0.1)
    asked = Demand(
        "attenuation", np.ones(3, complex), -np.ones(3, complex), np.array([1.0, 1.0, np.inf]), True, 1.0, error
    )
    q = np.array([0.5, 20.0, 20.0], complex)
    assert asked.reached(q, 0.5) == pytest.approx([0.5 / (1 - 0.05) / 0.5, np.inf, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(4, 3), (3, 5)])
def test_the_bound_of_a_direction_holds_for_a_law_of_all_channels(rng, shape):
    """What a law of all channels does along v, to the plant off by e v v' that suits it least, is within the bound."""
    plant = rectangular(rng, shape)
    law = Lqg().design(plant).controller
    quiet = band(rng)
    found = distance(plant, law, quiet, basis=10, uncertainty=0.1)
    print(found.status)
    if found.robust is None:
        assert found.status.word == "not certified"
        return
    assert not found.robust.bound_db > found.limit.bound_db
    v, f = found.direction, np.geomspace(*quiet, 60)
    G, K = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (plant, law))
    off = 0.1 * np.exp(1j * np.linspace(0, 2 * np.pi, 48, endpoint=False))
    true = np.array([np.linalg.inv(np.eye(shape[0]) - (np.eye(shape[0]) + e * np.outer(v, v)) @ G @ K) for e in off])
    worst = -20 * np.log10(np.abs(np.einsum("i,ekij,j->ek", v, true, v)).max())
    print(f"the worst of these plants: {worst:.2f} dB along v")
    if np.isfinite(found.robust.bound_db):
        assert worst <= found.robust.bound_db + 0.02


@pytest.mark.gate("0.3")
@pytest.mark.parametrize("error", [0.1, 0.3, 0.6])
def test_where_little_can_be_had_no_control_is_never_worse(error):
    """With next to no gain S = 1 is among what is sought: 0 dB on every plant, and what beats it is not passed by."""
    for gain in (0.05, 0.3, 1.0):
        limit = best_flat_attenuation(LAG, (10.0, 100.0), 6.0, control_gain=gain, uncertainty=error, basis=20)
        print(f"gain {gain}, error {error}: {limit.attenuation_db:.3f} to {limit.bound_db:.3f} dB, {limit.status}")
        assert limit.attenuation_db >= -0.02
        assert np.isnan(limit.bound_db) or limit.attenuation_db <= limit.bound_db


@pytest.mark.slow
def test_a_weight_that_is_a_system_and_a_plant_in_continuous_time():
    lag = StateSpace([[-100.0]], [[100.0]], [[1.0]], [[0.0]])
    weight = StateSpace([[-600.0]], [[1.0]], [[-540.0]], [[1.0]])  # 0.1 at rest, 1 far above 600 rad/s
    asked = {"control_gain": 20.0, "delay_s": 0.002, "basis": 40}
    plain, robust = (best_flat_attenuation(lag, (5.0, 20.0), 6.0, uncertainty=w, **asked) for w in (None, weight))
    print(f"{plain.status}\n{robust.status}")
    assert robust.status.ok
    assert robust.attenuation_db < plain.attenuation_db
    assert robust.attenuation_db <= robust.bound_db


def test_a_bound_of_the_plant_itself_is_one_of_every_plant():
    plain = Limit(Status(StatusWord.OK, "Plain."), 20.0, 25.0)
    for bound_db, word in (
        (40.0, StatusWord.OK),
        (np.nan, StatusWord.NOT_CERTIFIED),
        (np.inf, StatusWord.NOT_CERTIFIED),
    ):
        robust = tightened(Limit(Status(word, "Robust."), 18.0, bound_db), plain)
        assert robust.bound_db == 25.0
        assert robust.status.ok
        assert "25.0 dB" in robust.status.sentence
    closer = Limit(Status(StatusWord.OK, "Robust."), 18.0, 22.0)
    none = Limit(Status(StatusWord.REFUSED, "None."))
    assert tightened(closer, plain) is closer
    assert tightened(none, plain) is none


@pytest.mark.slow
def test_alike_channels_have_the_robust_limit_of_one():
    one = best_flat_attenuation(LAG, (20.0, 100.0), 6.0, control_gain=10.0, basis=25, uncertainty=0.2)
    for found in by_direction(append(LAG, LAG), (20.0, 100.0), 6.0, control_gain=10.0, basis=25, uncertainty=0.2):
        assert found.limit.attenuation_db == pytest.approx(one.attenuation_db, abs=0.05)
        assert found.limit.bound_db == pytest.approx(one.bound_db, abs=0.1)


@pytest.mark.slow
def test_demands_are_shapes_over_frequency():
    peak = ([5.0, 15.0, 200.0], [2.0, 2.0, 8.0])
    gains = ([100.0, 150.0], [20.0, 1.0])
    quiet = (20.0, 60.0)
    limit = best_flat_attenuation(LAG, quiet, peak, control_gain=gains, basis=60)
    print(limit.status)
    assert limit.status.ok, limit.status
    f = np.linspace(0.5, RATE_HZ / 2, 4000)
    S, KS = responses(LAG, limit.controller, f)
    allowed = 10 ** (np.interp(np.log(f), np.log(peak[0]), peak[1]) / 20)
    most = np.exp(np.interp(np.log(f), np.log(gains[0]), np.log(gains[1])))
    assert np.all(BETWEEN_POINTS * allowed >= S)
    assert np.all(BETWEEN_POINTS * most >= KS)
    assert limit.attenuation_db <= limit.bound_db
    milder = best_flat_attenuation(LAG, quiet, 8.0, control_gain=20.0, basis=60)
    assert milder.bound_db > limit.attenuation_db
    assert milder.attenuation_db > limit.attenuation_db
    flat = best_flat_attenuation(LAG, quiet, (1.0, 8.0), control_gain=([1.0], [20.0]), basis=60)
    assert best_flat_attenuation(LAG, quiet, np.asarray(8.0), control_gain=20.0, basis=60).status.ok
    assert flat.attenuation_db == pytest.approx(milder.attenuation_db, abs=0.01)


@pytest.mark.parametrize(
    "asked",
    [
        {"peak_db": ([1.0, 2.0], [3.0])},
        {"peak_db": ([2.0, 1.0], [3.0, 4.0])},
        {"peak_db": ([1.0], [400.0])},
        {"control_gain": ([1.0, 2.0], [3.0, 0.0])},
        {"control_gain": "much"},
        {"uncertainty": 0.0},
        {"uncertainty": ([1.0], [np.nan])},
        {"uncertainty": (1.0, 2.0, 3.0)},
        {"uncertainty": "0.1"},
    ],
    ids=str,
)
def test_a_shape_that_is_none_is_refused_by_name(asked):
    with pytest.raises(InputError, match=next(iter(asked))):
        best_flat_attenuation(LAG, (5.0, 50.0), **asked)
