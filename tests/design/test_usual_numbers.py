"""Numbers that nobody gave, beside those that were: in other units, and in another time, the same loop."""

import numpy as np
import pytest
from ordinary_plants import ordinary

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design.decoupling.modal import Modal
from ultraquiet.design.h2.usual_numbers import UsualVariances
from ultraquiet.design.hinf.gamma_search import BLURRED
from ultraquiet.design.hinf.problem.units import even_problem
from ultraquiet.design.hinf.usual_numbers import UsualNumbers

# Without units, or in units of inputs `u` and outputs `y`, and Hz: what is given of each design, and how it changes.
GIVEN = [
    (uq.design.MixedSensitivity, {"height": 6.0}, {}),
    (uq.design.MixedSensitivity, {"form": "skst", "height": 3.0, "order": 4}, {}),
    (uq.design.MixedSensitivity, {"form": "sks"}, {}),
    (uq.design.MixedSensitivity, {"noise": 0.5}, {"noise": lambda u, y: y}),
    (uq.design.MixedSensitivity, {"disturbance": 2.0}, {"disturbance": lambda u, y: u}),
    (uq.design.BandAttenuation, {"height": 4.0, "order": 4}, {}),
    (
        uq.design.BandAttenuation,
        {"control_limit": 30.0, "height": 4.0, "order": 4},
        {"control_limit": lambda u, y: u / y},
    ),
    (uq.design.Lqg, {"sensor_noise": 1e-3}, {"sensor_noise": lambda u, y: y**2}),
    (uq.design.Lqg, {"disturbance": 2.0, "disturbance_at": "input"}, {"disturbance": lambda u, y: u**2}),
    (uq.design.Lqg, {"control_weight": 1e-2}, {"control_weight": lambda u, y: (y / u) ** 2}),
    (Modal, {"sensor_noise": 1e-2}, {"sensor_noise": lambda u, y: y**2}),
    (Modal, {"disturbance": 1.0}, {"disturbance": lambda u, y: u**2}),
]
# Of ten plants drawn two are so loud that this limit is up to 2e9 times what undoes them: the least norm is the same in
# all units, and the law formed at a margin over it is not.
LOOSE = pytest.mark.draws(false_alarm=0.3)
NAMES = [f"{design.__name__}-{'-'.join(given)}" for design, given, _ in GIVEN]


def scaled(plant, u, y, faster=1.0):
    """Return the plant in other units, one of its inputs being `u` and one of its outputs `y` of the new ones."""
    return uq.StateSpace(plant.A, plant.B / u, plant.C * y, plant.D * y / u, plant.rate_hz * faster)


def largest(plant, law, f):
    """Return the largest singular value of S at each frequency."""
    G, K = (np.moveaxis(each.frequency_response(f), 2, 0) for each in (plant, law))
    return np.linalg.norm(np.linalg.inv(np.eye(G.shape[1]) - G @ K), 2, axis=(1, 2))


@pytest.mark.gate(
    "0.0001-100000.0-Lqg-sensor_noise",
    "0.0001-100000.0-Lqg-control_weight",
    "0.0001-100000.0-Modal-disturbance",
    "0.0001-100000.0-MixedSensitivity-form-height-order",
    "0.0001-100000.0-MixedSensitivity-form",
    "0.0001-100000.0-BandAttenuation-height-order",
    "1000000.0-0.001-MixedSensitivity-height",
    "1000000.0-0.001-Lqg-disturbance-disturbance_at",
)
@pytest.mark.parametrize(
    ("design", "given", "units"),
    [
        pytest.param(*each, marks=[LOOSE] if "control_limit" in each[1] else [], id=NAMES[k])
        for k, each in enumerate(GIVEN)
    ],
)
@pytest.mark.parametrize(("u", "y"), [(1e6, 1e-3), (1e-4, 1e5)])
def test_other_units_change_nothing(rng, design, given, units, u, y):
    plant = ordinary(rng, (2, 2), modes=3)
    one = design(**given).design(plant)
    rescaled = {name: value * units[name](u, y) if name in units else value for name, value in given.items()}
    other = design(**rescaled).design(scaled(plant, u, y))
    assert one.controller is not None, one.status
    assert one.status.word == other.status.word
    f = np.geomspace(1e-3, 0.45, 60) * plant.rate_hz
    there, here = largest(scaled(plant, u, y), other.controller, f), largest(plant, one.controller, f)
    print(f"{one.status.word}: S differs by {20 * np.log10(there / here).max():.1e} dB at most")
    np.testing.assert_allclose(there, here, rtol=0.01)  # norms are found to 1e-6, and the loops are fragile


@pytest.mark.parametrize(("design", "given"), [(d, g) for d, g, _ in GIVEN[:3]], ids=NAMES[:3])
def test_a_plant_that_is_a_thousand_times_as_fast_gets_the_same_law(rng, design, given):
    plant = ordinary(rng, (2, 2), modes=3)
    one, other = (design(**given).design(each) for each in (plant, scaled(plant, 1.0, 1.0, faster=1000.0)))
    f = np.geomspace(1e-3, 0.45, 60) * plant.rate_hz
    there, here = (
        largest(scaled(plant, 1.0, 1.0, 1000.0), other.controller, 1000.0 * f),
        largest(plant, one.controller, f),
    )
    np.testing.assert_allclose(there, here, rtol=0.01)  # norms are found to 1e-6, and the loops are fragile


def test_usual_numbers_are_those_of_the_plant(rng):
    plant = ordinary(rng, (4, 3), modes=4)
    usual, other = UsualNumbers.of(plant, None), UsualNumbers.of(scaled(plant, 1e3, 1e-2, faster=10.0), None)
    assert other.loudness == pytest.approx(usual.loudness * 1e-5)
    assert other.control_limit == pytest.approx(usual.control_limit * 1e5)
    assert (other.roll_off_hz, other.control_hz) == pytest.approx((10 * usual.roll_off_hz, 10 * usual.control_hz))
    assert usual.noise(usual.disturbance(3.0)) == pytest.approx(3.0)


@pytest.mark.parametrize("margin", [1.00003, 1.05])
def test_a_problem_in_which_control_costs_next_to_nothing_has_one_answer(margin):
    """A limit on K S 2e9 times what undoes the plant: the verified norm was 1.07 to 1.20 by the plant's units."""
    plant = ordinary(np.random.default_rng(20261301), (2, 2), modes=3)
    P = uq.design.BandAttenuation(control_limit=30.0, height=4.0, order=4).generalised(plant)
    norms = []
    for u, y in ((1.0, 1.0), (1e6, 1e-3), (1e-4, 1e5), (3.0, 1.0)):
        into, out = np.ones(P.B.shape[1]), np.ones(len(P.C))
        into[-2:], out[-2:] = u, y
        other = uq.StateSpace(P.A, P.B / into, P.C * out[:, None], P.D * out[:, None] / into, P.rate_hz)
        result = uq.design.synthesize_hinf(other, 2, 2, margin=margin, second_opinion=False)
        norms.append(result.achieved)
        assert result.details["optimum"][1] <= 1.065
        assert result.details["decided"] == ("not decided" not in result.status.sentence)
    print(f"verified norms at margin {margin:g}: {min(norms):.5f} to {max(norms):.5f}")
    assert max(norms) <= 1.001 * min(norms)


def test_noise_and_disturbance_are_the_one_by_the_other():
    for at_input in (True, False):
        usual = UsualVariances(0.1, at_input)
        assert usual.sensor_noise(usual.disturbance(4.0)) == pytest.approx(4.0)


def test_a_channel_without_any_response_says_nothing_of_the_loudness(rng):
    plant = ordinary(rng, (2, 2), modes=3)
    B, D = (np.hstack([part, np.zeros((len(part), 1))]) for part in (plant.B, plant.D))
    dead = uq.StateSpace(plant.A, B, plant.C, D, plant.rate_hz)
    one, other = (
        UsualNumbers.of(scaled(each, 1e6, 1.0), (0.02 * plant.rate_hz, 0.1 * plant.rate_hz)) for each in (plant, dead)
    )
    assert other.loudness == pytest.approx(one.loudness, rel=0.5)  # a mean over three columns in place of two


def test_decoupled_loops_share_the_numbers_of_the_whole(rng):
    one, two = (ordinary(rng, (1, 1), modes=2) for _ in range(2))
    rate = one.rate_hz
    whole = uq.values.interconnect.append(one, uq.StateSpace(two.A, two.B, two.C, two.D, rate))
    result = uq.design.Decoupled(
        transform=((1.0, 0.0), (0.0, 1.0)), settings={"height": 3.0, "order": 4}, disk_margin=0.0
    ).design(whole)
    usual = UsualNumbers.of(whole, None)
    for loop in result.details["loops"]:
        low = abs(loop.details["weights"]["control"].frequency_response([0.0])[0, 0, 0])
        assert 1 / low == pytest.approx(usual.control_limit, rel=1e-6)


@pytest.mark.parametrize("design", [uq.design.MixedSensitivity, uq.design.BandAttenuation])
def test_weights_that_the_plant_measures_are_not_there_beforehand(design):
    plant = uq.StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], 100.0)
    with pytest.raises(InputError, match="the plant is the measure"):
        design().weights(plant)
    assert set(design(height=3.0).weights(plant)) >= {"performance", "control"}


@pytest.mark.parametrize(("u", "y"), [(1e-4, 1e5), (1e-9, 1e9), (1e9, 1e9)])
def test_even_units_of_a_problem_stand_still(rng, u, y):
    """Where they did not, what the equations say of levels hung on the units that the plant came in."""
    design = uq.design.MixedSensitivity(form="sks")
    for _ in range(5):
        plant = scaled(ordinary(rng, (2, 2), modes=3), u, y)
        first = even_problem(design.generalised(plant, design.weights(plant)), 2, 2)
        again = even_problem(first.plant, 2, 2)
        assert again.level == 1.0
        assert {*again.controls, *again.measurements} == {1.0}


@pytest.mark.parametrize(("u", "y"), [(1.0, 1.0), (2.0, 1.0), (1e-4, 1e5)])
def test_poles_that_every_channel_repeats_are_put_together_where_no_level_was_solved(u, y):
    """Delays and the weights of two channels: eigenvectors anywhere in their spaces, cond 1e7.

    In coordinates of this condition responses are known to 6e-6 of themselves (the bound from them, against that of the
    plant as it is given), equations fail that could be solved, and the level to what a search says where that is so.
    """
    plant = ordinary(np.random.default_rng(4207922909), (2, 2), modes=3)
    found = uq.design.MixedSensitivity(form="sks").design(scaled(plant, u, y))
    print(f"{found.gamma:.6f}")
    assert found.gamma == pytest.approx(9.3395, rel=BLURRED)
