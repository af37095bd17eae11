"""No controller beats the limit at its own peak and gain; directions of several channels bound them all."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, band, modal, rectangular, regulator

import ultraquiet as uq
from ultraquiet.design import BandAttenuation, Lqg
from ultraquiet.limits import best_flat_attenuation, by_direction, distance
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append

# The levels compared come from grids of frequencies and a Hankel norm to 1e-5.
ROUNDING_DB = 0.02


@pytest.mark.gate("stable")
@pytest.mark.parametrize("growth", [1.0, 1.02], ids=["stable", "unstable"])
def test_no_lqg_controller_beats_its_limit(rng, growth):
    for _ in range(4):
        plant, quiet = modal(rng, growth=growth), band(rng)
        found = distance(plant, regulator(plant, rng), quiet, basis=20)
        print(f"{quiet}: {found.status}")
        assert found.status.word in ("ok", "not certified")
        if found.status.ok:
            assert found.left_db >= -ROUNDING_DB


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(3, 2), (2, 3)])
def test_no_controller_of_a_rectangular_plant_beats_its_limit(rng, shape):
    """Of a tall plant no controller moves all directions: what is left out stays at 0 dB or above."""
    ny, nu = shape
    plant = rectangular(rng, shape)
    law, quiet = Lqg().design(plant).controller, band(rng)
    found = distance(plant, law, quiet, basis=20)
    print(f"{shape}, {quiet}: {found.status}")
    assert found.status.word in ("ok", "not certified")
    if found.status.ok:
        assert found.left_db >= -ROUNDING_DB
        assert ("that the plant moves" in found.status.sentence) == (ny > nu)
    G, K = (np.moveaxis(s.frequency_response(np.geomspace(*quiet, 50)), 2, 0) for s in (plant, law))
    worst = np.linalg.norm(np.linalg.inv(np.eye(ny) - G @ K), 2, axis=(1, 2))
    if ny > nu:
        assert worst.min() >= 1 - 1e-9
    rows = by_direction(plant, quiet, found.peak_db, control_gain=found.control_gain, basis=20)
    assert len(rows) == min(shape)
    assert rows[0].limit.bound_db == pytest.approx(found.limit.bound_db, nan_ok=True)


def test_no_hinf_controller_beats_its_limit(rng):
    plant = modal(rng)
    for height in (4.0, 20.0):
        quiet = (20.0, 80.0)
        made = BandAttenuation(band_hz=(18.0, 88.0), height=height, order=4, control_limit=30.0, control_hz=150.0,
                               roll_off_hz=200.0).design(plant)  # fmt: skip
        if made.controller is None:
            continue
        found = distance(plant, made.controller, quiet, basis=20)
        print(f"height {height:g}: {found.status}")
        if found.status.ok:
            assert found.left_db >= -ROUNDING_DB


def test_the_best_controller_is_at_its_limit():
    """The sharpest case: the controller that a richer basis found, judged by the certificate of a poorer one."""
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    best = best_flat_attenuation(plant, (20.0, 100.0), 6.0, control_gain=10.0, basis=60)
    found = distance(plant, best.controller, (20.0, 100.0), basis=40)
    print(f"{best.status}\n{found.status}")
    assert found.attenuation_db == pytest.approx(best.attenuation_db, abs=0.1)
    assert -ROUNDING_DB <= found.left_db < 1.0


@pytest.mark.slow
def test_several_channels(rng):
    for _ in range(3):
        plant = modal(rng, channels=2)
        found = distance(plant, regulator(plant, rng), band(rng), basis=20)
        print(found.status)
        if found.status.ok:
            assert found.left_db >= -ROUNDING_DB


@pytest.mark.slow
def test_an_uncertainty_lowers_the_limit_of_every_direction():
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    pair, asked = append(lag, lag), {"control_gain": 10.0, "basis": 25, "directions": [[1.0], [0.0]]}
    certain = by_direction(pair, (20.0, 100.0), 6.0, **asked)[0].limit
    table = by_direction(pair, (20.0, 100.0), 6.0, uncertainty=([1.0, 100.0, 120.0], [0.1, 0.1, 1.5]), **asked)[0].limit
    alone = best_flat_attenuation(
        lag, (20.0, 100.0), 6.0, control_gain=10.0, basis=25, uncertainty=([1.0, 100.0, 120.0], [0.1, 0.1, 1.5])
    )
    print(f"{certain.attenuation_db:.2f} dB, {table.attenuation_db:.2f} dB with the uncertainty")
    assert table.attenuation_db < certain.attenuation_db - 1
    assert table.attenuation_db == pytest.approx(alone.attenuation_db, abs=0.05)
    assert table.bound_db >= table.attenuation_db - ROUNDING_DB


def test_alike_channels_have_the_limit_of_one():
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    one = best_flat_attenuation(lag, (20.0, 100.0), 6.0, control_gain=10.0, basis=25)
    for found in by_direction(append(lag, lag), (20.0, 100.0), 6.0, control_gain=10.0, basis=25):
        print(
            f"{one.attenuation_db:.3f} {one.bound_db:.3f}; {found.limit.attenuation_db:.3f} {found.limit.bound_db:.3f}"
        )
        assert found.limit.attenuation_db == pytest.approx(one.attenuation_db, abs=0.05)
        # the minimum-phase function of all actuators together is the lag itself
        assert found.limit.bound_db == pytest.approx(one.bound_db, abs=0.1)
        assert found.coupling_db > 100


@pytest.mark.slow
def test_worst_direction_on_the_bench():
    """A real 6 x 6 design of the true bench is bounded by the direction that the bench moves least."""
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    law = Lqg(band_hz=(9.0, 108.0), control_weight=1e-8).design(plant).controller
    found = distance(plant, law, (10.0, 100.0), basis=25)
    print(f"{found.status} (reached along it alone: {found.limit.attenuation_db:.1f} dB)")
    assert found.status.ok
    assert found.left_db > 0
    assert found.limit.attenuation_db <= found.limit.bound_db


def test_idle_and_unstable_laws():
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    static = [
        StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[k]], rate_hz=RATE_HZ) for k in (0.0, 9.0)
    ]
    assert distance(lag, static[0], (5.0, 50.0)).status.ok
    assert distance(lag, static[1], (5.0, 50.0)).status.word == "unstable"
    with pytest.raises(uq.errors.InputError, match="distance"):
        distance(lag, static[0], (5.0, 600.0))
    with pytest.raises(uq.errors.InputError, match="by_direction"):
        by_direction(append(lag, lag), (5.0, 50.0), directions=[[1.0], [1.0]])


def test_a_needle_in_the_band_is_the_worst_of_a_design():
    # two hardly damped modes, between which their velocities cancel and S is one
    A, moves = np.zeros((4, 4)), np.array([0.0, 1.0, 0.0, 1.0])
    for k, w in enumerate(2 * np.pi * np.array([8.0, 20.0])):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, w], [-w, -2e-6 * w]]
    plant = StateSpace(A, 20.0 * moves[:, None], moves[None], [[0.0]])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1e5]])
    assert distance(plant, law, (9.0, 19.0), basis=4).attenuation_db < 3.0
