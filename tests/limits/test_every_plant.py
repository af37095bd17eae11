"""With an uncertainty, peak and attenuation are those of every plant in it; demands may be shapes over frequency."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, band, modal, responses

from ultraquiet._base.errors import InputError
from ultraquiet.limits import best_flat_attenuation, by_direction, distance
from ultraquiet.limits.certificate import disc_of_every_plant
from ultraquiet.limits.programme import largest_sensitivity
from ultraquiet.values import StateSpace
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
    for end in (
        centre - radius,
        centre + radius,
    ):  # at the demand: no smaller disc about a real point will do
        assert abs(end) + error * peak * abs(1 - end) == pytest.approx(peak, rel=1e-9, abs=1e-12) or error >= 1


@pytest.mark.parametrize("growth", [1.0, 1.03], ids=["stable", "unstable"])
def test_its_controller_keeps_the_demands_on_every_plant(rng, growth):
    plant, quiet, error = modal(rng, growth=growth), band(rng), 0.15
    limit = best_flat_attenuation(plant, quiet, 6.0, control_gain=50.0, uncertainty=error, basis=30)
    print(f"{quiet}: {limit.status}")
    if not limit.status.ok:
        assert limit.status.word in ("not certified", "refused")
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


@pytest.mark.parametrize("shape", [(4, 3), (3, 5)])
def test_the_bound_of_a_direction_holds_for_a_law_of_all_channels(rng, shape):
    """A plant of several channels off by e v v': what the law of all channels does along v is within the bound."""
    ny, nu = shape
    square = modal(rng, max(shape))
    plant = StateSpace(square.A, square.B[:, :nu], square.C[:ny], square.D[:ny, :nu], RATE_HZ)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), -0.2 * rng.normal(size=(nu, ny)), RATE_HZ)
    while not feedback(plant, law).is_stable():
        law = StateSpace(law.A, law.B, law.C, 0.7 * law.D, RATE_HZ)
    quiet = band(rng)
    found = distance(plant, law, quiet, basis=20, uncertainty=0.1)
    print(found.status)
    assert found.robust is not None
    v, f = found.direction, np.geomspace(*quiet, 60)
    G, K = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (plant, law))
    s = np.einsum("i,kij,j->k", v, np.linalg.inv(np.eye(ny) - G @ K), v)
    off = 0.1 * np.exp(1j * np.linspace(0, 2 * np.pi, 24, endpoint=False))
    true = np.array([np.linalg.inv(np.eye(ny) - (np.eye(ny) + e * np.outer(v, v)) @ G @ K) for e in off])
    along = np.einsum("i,ekij,j->ek", v, true, v)
    assert np.allclose(along, s / (1 + off[:, None] * (1 - s)))  # what the bound rests on
    worst = -20 * np.log10(largest_sensitivity(s, np.full(f.size, 0.1)).max())
    if np.isfinite(found.robust.bound_db):
        assert worst <= found.robust.bound_db + 0.02
        assert not found.robust.bound_db > found.limit.bound_db


def test_alike_channels_have_the_robust_limit_of_one():
    one = best_flat_attenuation(LAG, (20.0, 100.0), 6.0, control_gain=10.0, basis=25, uncertainty=0.2)
    for found in by_direction(append(LAG, LAG), (20.0, 100.0), 6.0, control_gain=10.0, basis=25, uncertainty=0.2):
        assert found.limit.attenuation_db == pytest.approx(one.attenuation_db, abs=0.05)
        assert found.limit.bound_db == pytest.approx(one.bound_db, abs=0.1)


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
    flat = best_flat_attenuation(LAG, quiet, ([1.0], [8.0]), control_gain=([1.0], [20.0]), basis=60)
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
    ],
    ids=str,
)
def test_a_shape_that_is_none_is_refused_by_name(asked):
    with pytest.raises(InputError, match=next(iter(asked))):
        best_flat_attenuation(LAG, (5.0, 50.0), **asked)
