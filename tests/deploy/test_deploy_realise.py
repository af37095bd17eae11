"""Each form is the same law; where 2x2 blocks do not exist, it says so."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ, block
from scipy.linalg import block_diag

from ultraquiet._base.errors import NumericalError
from ultraquiet.analyse import hinf_norm
from ultraquiet.deploy import generate, kernel_cycles, realisation
from ultraquiet.deploy.law.blocks import block_diagonal
from ultraquiet.deploy.law.form_choice import choose, error_of, loop_radius
from ultraquiet.values import StateSpace

FORMS = ("modal", "delta", "schur", "dense")
F_HZ = np.geomspace(0.1, 1750.0, 300)


def response_of(parts):
    return StateSpace(parts.A(), parts.B, parts.C, parts.D, rate_hz=RATE_HZ).frequency_response(F_HZ)


def relative(one, other):
    return float(np.abs(one - other).max() / np.abs(other).max())


# A pole within 5e-6 of the circle multiplies what rounding leaves of it: 1 of 11 draws is off by 1.4e-9, in every form.
MANY = pytest.param(198, marks=pytest.mark.draws(false_alarm=0.1))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("states", [0, 1, 2, 25, 60, MANY])
def test_response_is_the_law_s(law_of, form, states):
    law = law_of(states)
    error = relative(response_of(realisation(law, form)), law.frequency_response(F_HZ))
    print(f"{form} {states}: {error:.1e}")
    assert error < 1e-9


def test_modal_blocks_are_rotations_of_equal_gain(law_of):
    parts = realisation(law_of(30), "modal")
    for k, b in enumerate(parts.blocks):
        rows = slice(2 * k, 2 * k + 2)
        assert b.shape == (2, 2)
        assert b[0, 0] == pytest.approx(b[1, 1], abs=1e-12)
        assert b[0, 1] == pytest.approx(-b[1, 0], rel=1e-9)
        assert np.linalg.norm(parts.B[rows]) == pytest.approx(np.linalg.norm(parts.C[:, rows]), rel=1e-9)


def defective(rng, name):
    pole = 0.98 * np.exp(0.1j)
    pair = block(pole)
    chains = {
        "twice the same pair": np.block([[pair, np.eye(2)], [np.zeros((2, 2)), pair]]),
        "three equal reals": 0.97 * np.eye(3) + np.diag([1.0, 1.0], 1),
        "four delays": np.diag(np.ones(3), 1),
        "delays and a mode": block_diag(np.diag(np.ones(5), 1), pair),
    }
    A = chains[name]
    n = len(A)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return StateSpace(T @ A @ T.T, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.eye(2), rate_hz=RATE_HZ)


CHAINS = ("twice the same pair", "three equal reals", "four delays", "delays and a mode")


@pytest.mark.parametrize("name", CHAINS)
def test_defective_law_falls_back_to_schur_blocks_and_states_the_condition(rng, tmp_path, name):
    law = defective(rng, name)
    parts = realisation(law, "schur")
    error = relative(response_of(parts), law.frequency_response(F_HZ))
    made = generate(law, tmp_path / "code", limits_v=1e3)
    print(f"{name}: schur {error:.1e}, {made.status}")
    assert error < 1e-9
    assert made.tables["eigenvector_condition"] > 1e4
    assert made.tables["form"] in ("schur", "dense")
    assert "eigenvector condition" in made.status.sentence
    assert made.tables["response_error"] < 5e-3


def test_two_equal_reals_share_a_block():
    law = StateSpace([[0.9, 1.0], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=RATE_HZ)
    parts = realisation(law, "modal")
    assert relative(response_of(parts), law.frequency_response(F_HZ)) < 1e-12


def test_modal_form_refuses_three_poles_that_cannot_be_told_apart(rng, tmp_path):
    law = defective(rng, "four delays")
    with pytest.raises(ValueError, match=r"modal form needs 2x2 blocks, but [34] poles .*eigenvector condition"):
        generate(law, tmp_path / "code", form="modal")


@pytest.mark.parametrize("bound", [0.0, 10.0, 1e6])
def test_block_diagonal_is_a_similarity(rng, bound):
    A = rng.standard_normal((12, 12))
    blocks, V = block_diagonal(A, bound)
    assert sum(len(b) for b in blocks) == 12
    error = np.abs(A @ V - V @ block_diag(*blocks)).max() / np.linalg.norm(V, 2)
    print(f"bound {bound:g}: {len(blocks)} blocks, residual {error:.1e}, condition {np.linalg.cond(V):.1e}")
    assert error < 1e-11
    if bound == 0.0:
        assert np.abs(V.T @ V - np.eye(12)).max() < 1e-12


def test_auto_takes_the_cheapest_form_that_is_exact_enough(law_of, tmp_path):
    made = generate(law_of(24), tmp_path / "code")
    tried = made.tables["forms_tried"]
    print(made.tables["form"], tried)
    assert set(tried) == set(FORMS)
    cheapest_first = sorted(FORMS, key=lambda form: kernel_cycles(form, 24, block=2))
    assert made.tables["form"] == next(form for form in cheapest_first if tried[form] <= 5e-3)


def test_auto_turns_to_delta_where_float32_moves_slow_poles(tmp_path):
    # 0.0002 Hz at 3.5 kHz: 1 - z is 4e-7, and float32 rounds z by up to 3e-8.
    pole = np.exp(2 * np.pi * 0.0002 * (-0.7 + 0.714j) / RATE_HZ)
    law = StateSpace(block(pole), [[1e-3], [1e-3]], [[1e-2, 1e-2]], [[0.1]], rate_hz=RATE_HZ)
    made = generate(law, tmp_path / "code")
    print(made.tables["forms_tried"])
    assert made.tables["form"] == "delta"
    assert made.tables["forms_tried"]["modal"] > 5e-3


def test_form_that_would_lose_the_loop_is_not_taken(tmp_path):
    # A pole 1e-8 inside the unit circle: float32 puts it upon it, A - I keeps it.
    law = StateSpace(np.diag([1 - 1e-8, 0.5]), [[1e-4], [0.1]], [[1e-4, 0.1]], [[0.0]], rate_hz=RATE_HZ)
    plant = StateSpace([[0.5]], [[0.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    made = generate(law, tmp_path / "code", plant=plant)
    assert made.tables["form"] == "delta"
    assert made.tables["forms_tried"]["modal"] is None
    with pytest.raises(NumericalError, match="with float32 coefficients in modal form; nothing was written"):
        generate(law, tmp_path / "lost", plant=plant, form="modal")
    assert not (tmp_path / "lost").exists()


def test_loop_decides_when_a_plant_is_given(law_of, rng, tmp_path):
    plant, law = law_of(12), law_of(24)
    small = -0.5 / (hinf_norm(plant)[0] * hinf_norm(law)[0])  # a loop that small gains keep stable
    law = StateSpace(law.A, law.B, small * law.C, small * law.D, rate_hz=RATE_HZ)
    made = generate(law, tmp_path / "code", plant=plant)
    assert "sensitivity" in made.status.sentence
    held = made.quantised
    G, K, R = (m.frequency_response(F_HZ).transpose(2, 0, 1) for m in (plant, law, held))
    exact, rounded = (np.linalg.inv(np.eye(6) - G @ k) for k in (K, R))
    change = np.linalg.norm(rounded - exact, 2, axis=(1, 2)) / np.linalg.norm(exact, 2, axis=(1, 2))
    print(f"{change.max():.1e} on another grid, {made.tables['response_error']:.1e} stated")
    assert change.max() < 2 * made.tables["response_error"] + 1e-6
    A = np.eye(3) * 0.5
    assert loop_radius(StateSpace(A, A, A, 0 * A, RATE_HZ), StateSpace(A, A, A, 0 * A, RATE_HZ)) == pytest.approx(0.75)


def test_error_is_that_of_the_response(law_of):
    law = law_of(10)

    louder = StateSpace(law.A, law.B, 1.01 * law.C, 1.01 * law.D, rate_hz=RATE_HZ)
    assert error_of(louder, law) == pytest.approx(0.01, rel=1e-6)


def test_no_form_left_is_a_refusal(law_of):
    def never(form):
        raise ValueError(f"{form} is impossible")

    with pytest.raises(ValueError, match="impossible"):
        choose(law_of(2), never, lambda law: 0)
