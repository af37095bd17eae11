"""LQG: recovery at either end, coloured noise, weights as systems, integral action, refusals by name."""

import numpy as np
import pytest
from named_plants import bench_like, sensitivity_db
from scipy.linalg import block_diag

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.analyse import h2_norm
from ultraquiet.design import Lqg, band_pass, high_pass
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, feedback, gain, lft, series

RATE = 1000.0
# These tests are about the equations; what their loops stand is asked of none of them.
STABLE = {"disk_margin": 0.0}
FLAT = STABLE | {"band_hz": None, "control_weight": 1e-2, "disturbance_at": "input"}
BAND = STABLE | {"band_hz": (9.0, 108.0)}


def minimum_phase(rng, channels=2, modes=3):
    """Return a square plant without delay and with all zeros inside: C B near one, zeros placed at stable points."""
    n = 2 * modes
    w, zeta = 2 * np.pi * rng.uniform(10, 150, modes), rng.uniform(0.01, 0.1, modes)
    poles = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w / RATE)
    A = np.zeros((n, n))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    while True:
        B, C = rng.standard_normal((n, channels)), rng.standard_normal((channels, n))
        CB = C @ B
        if np.linalg.cond(CB) < 5:
            # zeros are the eigenvalues of A - B (CB)^-1 C A beside the zeros at the origin
            zeros = np.linalg.eigvals(A - B @ np.linalg.solve(CB, C @ A))
            if np.abs(zeros).max() < 0.97:
                return StateSpace(A, B, C, np.zeros((channels, channels)), RATE)


@pytest.mark.parametrize("at", ["input", "output"])
@pytest.mark.parametrize("band_hz", [None, (10.0, 100.0)])
def test_recovery_of_a_minimum_phase_plant(rng, at, band_hz):
    """The error falls with the factor, to little where plants allow it, with a shaped cost or a flat one."""
    worst = []
    plant = minimum_phase(rng)
    for factor in (1.0, 1e4, 1e8):
        result = Lqg(**FLAT | {"band_hz": band_hz, "floor": 0.1}, recovery=factor, recovery_at=at).design(plant)
        assert result.status.ok, result.status
        assert result.details["recovery"]["at"] == at
        worst.append(result.details["recovery"]["relative_error"].max())
    print(f"recovery at the {at}, band {band_hz}: relative error " + " -> ".join(f"{e:.2g}" for e in worst))
    assert worst[2] < 0.02
    assert worst[2] < worst[0]


@pytest.mark.parametrize("at", ["input", "output"])
def test_recovery_is_what_it_says(rng, at):
    """The error in the details is |L - L_target| with L formed here from the finished controller."""
    plant = minimum_phase(rng)
    result = Lqg(**FLAT, recovery=100.0, recovery_at=at).design(plant)
    told = result.details["recovery"]
    G, K = (np.moveaxis(s.frequency_response(told["f_hz"]), 2, 0) for s in (plant, result.controller))
    size = np.linalg.norm(K @ G if at == "input" else G @ K, 2, axis=(1, 2))
    target = told["error"] / told["relative_error"]
    assert np.all(np.abs(size - target) <= told["error"] * (1 + 1e-6))


@pytest.mark.parametrize("at", ["input", "output"])
def test_a_delay_is_not_recovered_and_says_so(rng, at):
    plant = series(StateSpace(*discretize.delay(2, 2), rate_hz=RATE), minimum_phase(rng))
    error = Lqg(**FLAT, recovery=1e6, recovery_at=at).design(plant).details["recovery"]["relative_error"].max()
    print(f"recovery at the {at} through two samples of delay: relative error {error:.2g}")
    assert error > 0.3


@pytest.mark.slow
def test_covariances_in_full_are_scalars_when_they_are(rng):
    plant = bench_like(rng, 4)
    one = Lqg(**BAND, disturbance=0.3, sensor_noise=0.02).design(plant)
    two = Lqg(**BAND, disturbance_model=0.3 * np.eye(6), noise_model=0.02 * np.eye(6)).design(plant)
    assert abs(two.achieved / one.achieved - 1) < 1e-9
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    V = turn * np.geomspace(0.01, 1, 6) @ turn.T
    full = Lqg(**BAND, disturbance_model=V).design(plant)
    assert full.status.ok
    assert abs(full.gamma / full.achieved - 1) < 1e-6


@pytest.mark.draws(false_alarm=0.1)  # 1 of 11 plants has a direction that neither law reaches, 0 dB with both
def test_a_coloured_disturbance_is_met_at_its_colour(rng):
    """A disturbance round 30 Hz: the controller made for it leaves less of it than the one made for white noise."""
    plant = bench_like(rng, 6)
    colour = append(*[band_pass((25.0, 36.0), 1.0, 0.01, 4, 3500.0)] * 6)
    settings = {"band_hz": None, "control_weight": 1e-6, "sensor_noise": 1e-3}
    made = Lqg(**settings, disturbance_model=colour)
    for_it, for_white = made.design(plant), Lqg(**settings).design(plant)
    P = made.generalised(plant)
    left = [h2_norm(lft(P, result.controller)) for result in (for_it, for_white)]
    print(f"coloured disturbance: {left[0]:.4f} with its model, {left[1]:.4f} with a white one")
    assert abs(for_it.gamma / left[0] - 1) < 1e-6
    assert left[0] < left[1]
    f_hz = np.linspace(26, 35, 20)
    low, high = (np.linalg.norm(lft(P, r.controller).frequency_response(f_hz)) for r in (for_it, for_white))
    print(f"over 26-35 Hz {low:.3g} and {high:.3g}")
    assert low < high
    low, high = (sensitivity_db(plant, r.controller, np.linspace(26, 35, 20)).max() for r in (for_it, for_white))
    assert low < high


@pytest.mark.slow
def test_coloured_sensor_noise_turns_the_sensors_down_where_it_is(rng):
    plant = bench_like(rng, 5)
    noisy = append(*[high_pass(200.0, 0.03, 3.0, 1, 3500.0)] * 6)
    for_it, for_white = (
        Lqg(**BAND, **noise).design(plant) for noise in ({"noise_model": noisy}, {"sensor_noise": 0.03**2})
    )
    assert for_it.status.ok
    size = [np.abs(r.controller.frequency_response([1500.0])).max() for r in (for_it, for_white)]
    print(f"gain of the controller at 1500 Hz: {size[0]:.3g} for coloured sensor noise, {size[1]:.3g} for white")
    assert size[0] < size[1]


@pytest.mark.slow
def test_weights_as_systems_are_the_numbers_they_stand_for(rng):
    plant = bench_like(rng, 4)
    numbers = Lqg(**BAND, control_weight=1e-6, control_hz=300.0)
    weights = numbers.weights(plant)
    systems = Lqg(output_weight=weights["performance"], input_weight=append(*[weights["control"]] * 6), band_hz=None)
    one, two = numbers.design(plant), systems.design(plant)
    assert abs(two.achieved / one.achieved - 1) < 1e-9
    flat = Lqg(**BAND, control_weight=1e-6).design(plant)
    size = [np.abs(r.controller.frequency_response([1500.0])).max() for r in (one, flat)]
    assert size[0] < size[1], "a weight on u that rises must turn the controller down up there"


def test_a_pure_integrator_is_a_part_of_the_controller(rng):
    """Constant disturbances leave nothing at the output; its pole is in the controller, not in the weights."""
    plant = minimum_phase(rng)
    result = Lqg(**FLAT | {"disturbance_at": "output"}, integral_hz=2.0).design(plant)
    assert result.status.ok, result.status
    assert np.sum(np.abs(result.controller.poles() - 1) < 1e-9) == 2
    left = sensitivity_db(plant, result.controller, np.array([1e-4]))[0]
    loop = feedback(plant, result.controller)
    settled = int(np.ceil(np.log(1e-9) / np.log(np.abs(loop.poles()).max())))
    rest = np.abs(loop.simulate(np.ones((2, settled)))[:, -1]).max()
    print(f"integral action: S of {left:.0f} dB at 0.1 mHz, {rest:.1e} left of a constant disturbance")
    assert left < -60
    assert rest < 1e-4
    assert abs(result.gamma / result.achieved - 1) < 1e-6


def test_a_leaking_integrator_serves_plants_that_do_not_answer_at_rest(rng):
    """Geophones have zeros at 0 Hz: a pure integrator is refused with a sentence, a leaking one designed."""
    differentiator = StateSpace([[0.0]], [[1.0]], [[-1.0]], [[1.0]], RATE)
    plant = series(minimum_phase(rng), append(differentiator, differentiator))
    pure = Lqg(**FLAT, integral_hz=2.0).design(plant)
    assert pure.status.word == "refused"
    assert pure.controller is None
    assert "zero at 0 Hz" in str(pure.status)
    leaking = Lqg(**FLAT, integral_hz=2.0, integral_leak_hz=0.1).design(plant)
    assert leaking.status.ok, leaking.status


def test_more_outputs_than_inputs_cannot_all_be_integrated(rng):
    plant = minimum_phase(rng)
    tall = StateSpace(plant.A, plant.B[:, :1], plant.C, plant.D[:, :1], RATE)
    result = Lqg(**FLAT, integral_hz=2.0).design(tall)
    assert result.status.word == "refused"
    assert "1 input for 2 outputs" in str(result.status)


@pytest.mark.slow
def test_the_band_in_the_loop_shapes_the_controller(rng):
    """With the band in the loop the controller carries its poles, and is smaller outside of it."""
    plant = bench_like(rng, 6)
    settings = STABLE | {"band_hz": (10.0, 60.0), "control_weight": 1e-4}
    inside, outside = (Lqg(**settings, band_at=at).design(plant) for at in ("loop", "cost"))
    assert inside.status.ok
    shape = [
        np.linalg.norm(r.controller.frequency_response([600.0])[..., 0], 2)
        / np.linalg.norm(r.controller.frequency_response([25.0])[..., 0], 2)
        for r in (inside, outside)
    ]
    print(f"gain at 600 Hz over that at 25 Hz: {shape[0]:.3g} with the band in the loop, {shape[1]:.3g} in the cost")
    band = band_pass((10.0, 60.0), 1.0, 0.06, 8, 3500.0).poles()
    assert all(np.abs(inside.controller.poles() - p).min() < 1e-4 for p in band)


def unstable(reachable):
    B, C = np.array([[1.0], [0.0]]), np.array([[1.0, 1.0]])
    return StateSpace(np.diag([0.9, 1.1]), *((B, C) if not reachable else (C.T, B.T)), [[0.0]], RATE)


def test_unstable_modes_out_of_reach_name_the_matrix():
    for reachable, matrix in ((False, "(B)"), (True, "(C)")):
        result = Lqg(**FLAT).design(unstable(reachable))
        assert result.status.word == "refused"
        assert result.controller is None
        assert matrix in str(result.status)
        assert "1.1" in str(result.status)


def test_a_lone_integrator_that_nothing_drives_is_named():
    result = Lqg().design(StateSpace([[1.0]], [[0.0]], [[1.0]], [[0.0]], RATE))
    assert result.status.word == "refused"
    assert "(B)" in str(result.status)


def test_unstable_plants_are_stabilised():
    plant = StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], RATE)
    for settings in (FLAT, FLAT | {"disturbance_at": "output"}):
        result = Lqg(**settings).design(plant)
        assert result.status.ok, result.status
        assert abs(result.gamma / result.achieved - 1) < 1e-6


BAD = [
    ({"output_weight": StateSpace([[1.0]], [[1.0]], [[1.0]], [[1.0]], RATE)}, InputError, "output_weight.*pole"),
    ({"input_weight": StateSpace([[-1.0]], [[1.0]], [[1.0]], [[1.0]], RATE)}, InputError, "input_weight.*pole"),
    ({"disturbance_model": append(*[StateSpace([[1.0]], [[1.0]], [[1.0]], [[1.0]], RATE)] * 2)}, InputError, "pole"),
    ({"output_weight": gain([[1.0]], 2 * RATE)}, RateError, "output_weight"),
    ({"input_weight": gain([[1.0]])}, RateError, "input_weight"),
    ({"noise_model": append(*[gain([[1.0]], 2 * RATE)] * 2)}, RateError, "noise_model"),
    ({"disturbance_model": append(*[gain([[1.0]])] * 2)}, RateError, "disturbance_model"),
    ({"output_weight": gain(np.eye(3), RATE)}, InputError, "output_weight"),
    ({"noise_model": np.diag([1.0, 0.0])}, InputError, "noise_model.*singular"),
    ({"noise_model": [[1.0, 2.0], [2.0, 1.0]]}, InputError, "noise_model.*covariance"),
    ({"noise_model": [[1.0, 0.5], [0.1, 1.0]]}, InputError, "noise_model.*covariance"),
    ({"disturbance_model": np.eye(3)}, InputError, "disturbance_model"),
    ({"noise_model": gain(np.eye(3), RATE)}, InputError, "noise_model"),
    ({"integral_hz": 2.0, "integral_leak_hz": 3.0}, InputError, "integral_hz"),
    ({"integral_hz": RATE}, InputError, "integral_hz"),
]


@pytest.mark.parametrize(("settings", "error", "match"), BAD)
def test_bad_settings_are_refused_by_name(rng, settings, error, match):
    with pytest.raises(error, match=match):
        Lqg(**FLAT | settings).design(minimum_phase(rng))


def test_units_change_no_verdict_on_a_band_in_the_loop(rng):
    """States of the law and of the plant then differ by as much in size: the cost that is achieved was not found."""
    z = np.exp([-0.048 + 0.9j, -6.4e-6 + 0.05j])
    A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in z), [[0.999]])
    B, C = rng.standard_normal((5, 1)), rng.standard_normal((1, 5))
    g = np.abs(StateSpace(A, B, C, [[0.0]], RATE).frequency_response([50.0]))[0, 0, 0]
    words, costs = set(), []
    for u, y in ((1.0, 1.0), (1e9, 1.0), (1e-9, 1.0), (1.0, 1e9), (1.0, 1e-9), (1e9, 1e9), (1e-9, 1e-9)):
        design = Lqg(band_at="loop", band_hz=(10.0, 100.0), control_weight=1e-9 * (g * y * u) ** 2)
        result = design.design(StateSpace(A, u * B, y * C, [[0.0]], RATE))
        words.add(result.status.word)
        costs.append(result.achieved)  # of disturbance and noise at the outputs, whatever their unit
    assert len(words) == 1, words
    assert result.controller is not None
    assert costs == pytest.approx(costs[:1] * len(costs), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
@pytest.mark.parametrize("plant", ["integrator", "two integrators", "undamped mode"])
def test_poles_on_the_boundary_at_the_default_disturbance(plant, unit):
    A, B = {
        "integrator": ([[0.0]], [[1.0]]),
        "two integrators": ([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]),
        "undamped mode": ([[0.0, 20.0], [-20.0, 0.0]], [[0.0], [1.0]]),
    }[plant]
    C = np.eye(1, len(A))
    M = discretize.zero_order_hold(np.array(A), unit * np.array(B), C, np.zeros((1, 1)), 1e-3)
    result = Lqg().design(StateSpace(*M, rate_hz=1000.0))
    assert result.status.ok, result.status
    if unit == 1:
        result = Lqg(control_weight=1e-4).design(StateSpace(*M, rate_hz=1000.0))
        assert result.status.ok, result.status


@pytest.mark.parametrize("estimator", ["current", "predicted"])
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (3, 5)])
def test_a_plant_that_no_sensor_sees_gets_a_law_however_ill_its_states(ny, nu, estimator, rng):
    """The cost is nothing; what is achieved was the round-off of states that lead nowhere, and so was refused."""
    n = 20
    A = np.diag(rng.uniform(0.3, 0.999, n)) + np.triu(1e3 * rng.standard_normal((n, n)), 1)
    plant = StateSpace(A, rng.standard_normal((n, nu)), np.zeros((ny, n)), np.zeros((ny, nu)), 858.0)
    asked = {"band_hz": (24.4, 195.2), "control_weight": 0.02, "sensor_noise": 0.0016, "disturbance_at": "input"}
    result = Lqg(**asked, disturbance=1.0, estimator=estimator).design(plant)
    assert result.status.ok, result.status
    assert (result.gamma, result.achieved) == (0.0, 0.0)
