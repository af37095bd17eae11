"""Glover-McFarlane loop shaping: SLICOT's three routines, textbook levels, the level reached from both sides."""

import numpy as np
import pytest

from slicot_examples import SLICOT, numbers, printed
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import hinf_norm, singular_values
from ultraquiet.design import LoopShaping
from ultraquiet.design.hinf import coprime_stabilisation as kernel
from ultraquiet.linalg import discretize, realize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, lft

HALF_A_DIGIT = 5.5e-5  # of four printed decimals


def example(name):
    """Return a shaped plant and the factor over the optimum; SB10KD's has no direct term."""
    values = numbers((SLICOT / f"{name}.dat").read_text().split("\n", 1)[1])
    n, m, p = (int(v) for v in values[:3])
    rest, matrices = values[3:], []
    for rows, columns in ((n, n), (n, m), (p, n), (p, m))[: 3 if name == "SB10KD" else 4]:
        matrices.append(np.reshape(rest[: rows * columns], (rows, columns)))
        rest = rest[rows * columns :]
    return (*matrices, np.zeros((p, m)))[:4], rest[0]


def transfer(num, den, rate_hz=None):
    """Return num(s) / den(s), held by a zero-order hold when a rate is given."""
    num, den = np.array(num, float) / den[0], np.array(den, float) / den[0]
    M = realize.sections(np.r_[np.zeros(len(den) - len(num)), num], den)
    return StateSpace(*(M if rate_hz is None else discretize.zero_order_hold(*M, 1 / rate_hz)), rate_hz=rate_hz)


@pytest.mark.parametrize(("name", "states"), [("SB10ID", 5), ("SB10KD", 6), ("SB10ZD", 6)])
def test_slicot_controllers(name, states):
    """Printed controllers, compared by Markov parameters: each realisation carries its own similarity."""
    M, factor = example(name)
    ours = (kernel.continuous if name == "SB10ID" else kernel.discrete)(M, factor)
    n, m, p = states, M[1].shape[1], M[2].shape[0]
    titles = [
        ("state matrix AK", (n, n)),
        ("input matrix BK", (n, p)),
        ("output matrix CK", (m, n)),
        ("matrix DK", (m, p)),
    ]
    A, B, C, D = (printed(name, f"The controller {title} is", shape) for title, shape in titles)
    assert ours.controller[0].shape == (n, n)
    np.testing.assert_allclose(ours.controller[3], D, atol=HALF_A_DIGIT)
    for power in range(3):
        parts = [C, *[A] * power, B]
        wanted = np.linalg.multi_dot(parts)
        found = np.linalg.multi_dot([ours.controller[2], *[ours.controller[0]] * power, ours.controller[1]])
        # what rounding every printed entry can do to the product, to first order
        allowed = HALF_A_DIGIT * sum(
            np.max(np.linalg.multi_dot([np.abs(x) if k != j else np.ones(x.shape) for k, x in enumerate(parts)]))
            for j in range(len(parts))
        )
        print(f"{name}, CA^{power}B: {np.abs(found - wanted).max():.1e} off, rounding allows {allowed:.1e}")
        np.testing.assert_allclose(found, wanted, atol=allowed)
    # and what SLICOT calls success: the loop it closes is the loop we close
    rate = None if name == "SB10ID" else 1.0
    theirs, own = (
        feedback(StateSpace(*M, rate_hz=rate), StateSpace(*K, rate_hz=rate)) for K in ((A, B, C, D), ours.controller)
    )
    assert theirs.is_stable()
    assert own.is_stable()


def test_slicot_conditions():
    """Reciprocal conditions that do not depend on the coordinates of the solver, to the digits printed."""
    plants = {name: example(name) for name in ("SB10KD", "SB10ZD")}
    kd, zd = (kernel.discrete(*plants[name]).conditions for name in plants)
    title = "The estimated condition numbers are"
    kd_printed, zd_printed = printed("SB10KD", title, (1, 4))[0], printed("SB10ZD", title, (1, 6))[0]
    np.testing.assert_allclose(kd["inner"], kd_printed[3], rtol=1e-4)
    np.testing.assert_allclose([zd["W"], zd["inner"], zd["inputs"]], zd_printed[[2, 3, 5]], rtol=1e-4)


def test_skogestads_example_continuous_and_sampled():
    """S&P example 9.3: gamma_min 2.34; held at 0.01 s 2.4086 (RobustAndOptimalControl.jl, test_glover_mcfarlane.jl)."""
    lag, integral = ([200.0], np.convolve([10, 1], np.convolve([0.05, 1], [0.05, 1]))), ([1.0, 2.0], [1.0, 1e-6])
    for rate, wanted, digits in ((None, 2.34, 5e-3), (100.0, 2.4086, 5e-5)):
        for margin in (1.0, 1.1, 1.5):
            result = LoopShaping(pre=transfer(*integral, rate), margin=margin).design(transfer(*lag, rate))
            level = result.details["gamma_min"]
            print(
                f"rate {rate}, margin {margin}: gamma_min {level:.5f}, reached {result.achieved:.5f}; {result.status}"
            )
            assert result.status.ok
            assert abs(level - wanted) < digits
            assert abs(level / result.details["gamma_min_mapped"] - 1) < 1e-6
            assert abs(result.gamma / result.achieved - 1) < 1e-3
            assert level * (1 - 1e-4) < result.achieved <= margin * level * (1 + 1e-6)


def test_margin_of_a_published_loop():
    """P = (s + 5) / (s^2 + 2 s + 10) with an integrator at 1.1 times the optimum: 0.6325 (the same test file)."""
    integrator = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    result = LoopShaping(pre=integrator).design(transfer([1.0, 5.0], [1.0, 2.0, 10.0]))
    print(f"epsilon {result.details['epsilon']:.5f}")
    assert abs(result.details["epsilon"] - 0.6325) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [None, 1.0])
def test_promised_level_is_reached_on_random_plants(rng, rate_hz):
    """Unstable plants with every direct term: the level found is reached, and no other controller passes below it."""
    worst = 0.0
    for _ in range(8):
        n = int(rng.integers(1, 8))
        A = rng.standard_normal((n, n)) / np.sqrt(n)
        M = (A, rng.standard_normal((n, 2)), rng.standard_normal((3, n)), 0.5 * rng.standard_normal((3, 2)))
        plant = StateSpace(*M, rate_hz=rate_hz)
        for margin in (1.0, 1.02, 1.4):
            result = LoopShaping(pre=1.0, margin=margin, disk_margin=0.0).design(plant)
            assert result.status.ok, result.status
            # digits go as the level: 1 / gamma is how far the shaped plant is from one that cannot be stabilised
            rounding = 1e-6 * result.details["gamma_min"]
            assert result.achieved >= result.details["gamma_min"] * (1 - rounding)
            assert result.achieved <= result.details["level"] * (1 + rounding)
            worst = max(worst, abs(result.gamma / result.achieved - 1))
            worst = max(worst, abs(result.details["gamma_min_mapped"] / result.details["gamma_min"] - 1))
    print(f"loop shaping, rate {rate_hz}: two ways to each number differ by {worst:.1e} at most")
    assert worst < 1e-4


def test_gap_is_what_the_plant_may_move(rng):
    """Coprime factors perturbed by less than epsilon keep the loop stable, whatever the perturbation."""
    plant = transfer([1.0, 5.0], [1.0, 2.0, 10.0])
    result = LoopShaping(pre=1.0).design(plant)
    Ks, S = result.details["stabiliser"], result.details["shaped"]
    H = result.details["observer"]["H"]
    for _ in range(50):
        A = np.diag(-rng.uniform(0.1, 30, 2))
        raw = StateSpace(A, rng.standard_normal((2, 2)), rng.standard_normal((1, 2)), rng.standard_normal((1, 2)))
        size = 0.999 * result.details["epsilon"] / hinf_norm(raw)[0]
        # (M + dM) y = (N + dN) u, [dN dM] = size * raw driven by (u, y): an LFT round the coprime factors
        both = StateSpace(raw.A, raw.B, size * raw.C, size * raw.D)
        P = StateSpace(
            S.A,
            np.hstack([-H, S.B]),
            np.vstack([np.zeros((1, 2)), S.C]),
            np.array([[0.0, 1.0], [1.0, 0.0]]),
        )  # (w, u) -> (u, y) with y = M^-1 w + N' u
        closed = lft(StateSpace(P.A, P.B, np.vstack([P.C, S.C]), np.vstack([P.D, [[1.0, 0.0]]])), Ks)
        assert feedback(closed, both).is_stable()


def test_numbers_describe_a_loop_and_weak_directions_are_lifted(rng):
    modes = StateSpace([[0.98]], [[1.0]], [[1.0]], [[0.0]], 1000.0)
    skew = np.array([[1.0, 0.9], [0.9, 1.0]])
    plant = StateSpace(np.kron(np.eye(2), modes.A), np.eye(2), 0.01 * skew, np.zeros((2, 2)), 1000.0)
    settings = {"band_hz": (10.0, 60.0), "height": 5.0, "integral_hz": 1.0, "tones_hz": (25.0,), "tone_height": 10.0}
    spreads = []
    for align in (False, True):
        result = LoopShaping(**settings, align=align).design(plant)
        assert result.status.ok, result.status
        sizes = np.linalg.svd(result.details["shaped"].frequency_response([24.5])[:, :, 0], compute_uv=False)
        spreads.append(sizes[0] / sizes[1])
    print(f"strongest over weakest direction: {spreads[0]:.1f} as the plant is, {spreads[1]:.2f} aligned")
    assert spreads[0] > 10
    assert spreads[1] < 1.01
    at_tone = np.linalg.svd(result.details["shaped"].frequency_response([25.0])[:, :, 0], compute_uv=False)
    assert at_tone[1] > 5 * sizes[1]
    assert result.controller.states > plant.states
    assert result.details["wanted"].shape == result.details["loop"].shape == (2, result.details["f_hz"].size)


def test_shape_survives_within_gamma():
    """McFarlane and Glover: where the drawn loop is high, the loop has at least its gain over gamma or so."""
    lag, integral = (
        transfer([200.0], np.convolve([10, 1], np.convolve([0.05, 1], [0.05, 1]))),
        transfer([1.0, 2.0], [1.0, 1e-6]),
    )
    result = LoopShaping(pre=integral).design(lag)
    wanted, loop, gamma = result.details["wanted"][0], result.details["loop"][0], result.details["level"]
    high, low = wanted > 30, wanted < 1 / 30
    bound = np.sqrt(gamma**2 - 1)
    print(f"loop over drawn: {(loop / wanted)[high].min():.2f} where high, {(loop / wanted)[low].max():.2f} where low")
    assert np.all((loop / wanted)[high] > 0.9 / bound)
    assert np.all((loop / wanted)[low] < 1.1 * bound)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"pre": StateSpace([[2.0]], [[1.0]], [[1.0]], [[0.0]], 1000.0)}, "'pre' is unstable"),
        ({"pre": StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 500.0)}, "the weight 'pre' is sampled at 500 Hz"),
        ({"post": StateSpace([[-0.5]], [[1.0]], [[1.0]], [[0.0]])}, "the weight 'post' is in continuous time"),
        ({"pre": StateSpace(np.eye(0), np.zeros((0, 3)), np.zeros((2, 0)), np.ones((2, 3)), 1000.0)}, "'pre' is 2 x 3"),
        ({"post": (1.0, 2.0)}, "'post' must be a StateSpace, a gain"),
        ({"margin": 0.9}, "'margin'"),
    ],
)
def test_mistakes_name_the_block(settings, complaint):
    plant = StateSpace(0.9 * np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), 1000.0)
    with pytest.raises(InputError, match=complaint):
        LoopShaping(**settings).design(plant)


def test_what_cannot_be_stabilised_is_refused():
    hidden = StateSpace(np.diag([2.0, 0.5]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]], 10.0)
    result = LoopShaping(pre=1.0).design(hidden)
    print(result.status)
    assert not result.status.ok
    assert result.controller is None
    assert "is out of reach of the inputs" in result.status.sentence


def test_integrators_before_a_plant_that_does_not_answer_at_0_hz_are_refused_for_that():
    w = 2 * np.pi * np.array([4.5, 15.0])
    geophone = transfer([1.0, 0.0, 0.0], np.polymul([1, 1.4 * w[0], w[0] ** 2], [1, 0.04 * w[1], w[1] ** 2]), 1000.0)
    w = 2 * np.pi * 12.0
    velocity = transfer([w, 0.0], [1.0, 0.02 * w, w**2], 1000.0)
    wide = StateSpace([[0.9]], [[0.1, 0.2]], [[1.0]], [[0.0, 0.0]], 1000.0)
    for plant, why in ((geophone, "a zero at 0 Hz"), (velocity, "a zero at 0 Hz"), (wide, "2 inputs for 1 output")):
        result = LoopShaping(integral_hz=1.0).design(plant)
        print(result.status)
        assert result.controller is None
        assert f"(it has {why})" in result.status.sentence
        assert LoopShaping().design(plant).controller is not None


def test_an_integrator_that_no_output_shows_is_named():
    hidden = StateSpace(np.diag([1.0, 0.9]), [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]], 1000.0)
    sentence = LoopShaping().design(hidden).status.sentence
    print(sentence)
    assert sentence.startswith("LoopShaping: an unstable mode of the plant, at 0 Hz with |z| = 1, does not show")


def test_integrator_in_the_weight_reaches_the_controller():
    plant = transfer([1.0], [1.0, 1.0], 100.0)
    result = LoopShaping(pre=transfer([1.0], [1.0, 0.0], 100.0)).design(plant)
    assert result.status.ok
    assert np.abs(result.controller.poles() - 1).min() < 1e-9
    assert result.controller.states == 3  # the two of the shaped plant and the weight


@pytest.mark.parametrize("rate_hz", [None, 100.0])
@pytest.mark.parametrize(("channels", "gain"), [(1, 1.0), (3, -1.0), (2, 1e3)])
@pytest.mark.parametrize("margin", [1.0, 1.05])
def test_a_gain_without_states_gets_a_gain(rate_hz, channels, gain, margin):
    """Of G = 1 the best law is -1, which leaves S = 1/2 at all frequencies: a loop that stands every change."""
    one = np.eye(channels)
    static = StateSpace(np.zeros((0, 0)), np.zeros((0, channels)), np.zeros((channels, 0)), gain * one, rate_hz)
    result = LoopShaping(pre=1.0, margin=margin).design(static)
    assert result.status.ok, result.status
    assert result.controller.states == 0
    np.testing.assert_allclose(result.controller.D, -gain * one, rtol=1e-9)
    if abs(gain) == 1:
        assert all(end.disk_all == np.inf for end in result.margins.values())


@pytest.mark.parametrize("unit", [1.0, 1e9])
@pytest.mark.parametrize("settings", [{}, {"pre": 1.0}, {"band_hz": (7.0, 12.0), "height": 2.0}])
def test_an_undamped_mode_is_shaped_as_any_other(settings, unit):
    w = 2 * np.pi * 7.0
    A, B, C = [[0.0, w], [-w, 0.0]], [[0.0], [np.sqrt(w)]], [[0.0, np.sqrt(w)]]
    found = LoopShaping(**settings).design(StateSpace(A, np.array(B) / unit, np.array(C) * unit, [[0.0]]))
    assert found.status.ok
    assert found.closed_loop_poles.real.max() < 0


def test_the_gains_of_a_plant_are_infinite_on_its_poles():
    integrators = StateSpace(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)))
    assert singular_values(integrators, [0.0, 1.0]) == pytest.approx(np.array([[np.inf, 0.5 / np.pi]] * 2))


@pytest.mark.parametrize("rate_hz", [None, 10.0])
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (2, 2), (4, 3), (3, 5)])
@pytest.mark.parametrize("height", [None, 4.0])
def test_a_plant_loud_from_rest_gets_no_loop_slower_than_itself(rate_hz, ny, nu, height):
    """One lag on all channels: its band has no lower edge, and neither has the shape of the loop."""
    pole, held = (-1.0, 1.0) if rate_hz is None else (np.exp(-1 / rate_hz), 1 - np.exp(-1 / rate_hz))
    B, C = held * 0.5 ** np.arange(nu)[None, :], 0.5 ** np.arange(ny)[:, None]
    plant = StateSpace([[pole]], B, C, np.zeros((ny, nu)), rate_hz)
    result = LoopShaping(height=height).design(plant)
    assert result.status.ok, result.status
    poles = np.linalg.eigvals(feedback(plant, result.controller).A)
    speed = -poles.real if rate_hz is None else (1 - np.abs(poles)) * rate_hz
    assert speed.min() > 0.1
