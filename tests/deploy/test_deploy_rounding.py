"""Word length: what float32 does to modes, response and running sums, form by form."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ, block

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import Twin, generate, realisation, rounding_errors
from ultraquiet.deploy.law.rounding import rounded
from ultraquiet.values import StateSpace


def mode_of(pole):
    s = np.log(complex(pole)) * RATE_HZ
    return abs(s) / (2 * np.pi), -s.real / abs(s)


def single_mode(f_hz, damping):
    s = 2 * np.pi * f_hz * (-damping + 1j * np.sqrt(1 - damping**2))
    return StateSpace(block(np.exp(s / RATE_HZ)), [[0.1], [0.1]], [[0.1, 0.1]], [[0.0]], rate_hz=RATE_HZ)


def quantised(law, form):
    parts = realisation(law, form)
    limits = np.array([[-25.0, 25.0]])
    return rounded(parts, None, limits, "float32", rate_hz=RATE_HZ, order=law.states).state_space()


UNIT = 2.0**-24  # of float32


@pytest.mark.parametrize("form", ["modal", "delta"])
def test_float32_keeps_modes(rng, form):
    """Rounding moves z by at most UNIT |z| in modal, UNIT |z - 1| in delta form, so s by that over T |z|."""
    worst, share = np.zeros(2), 0.0
    for _ in range(200):
        f_hz, zeta = rng.uniform(5.0, 300.0), 10 ** rng.uniform(-2.5, -0.5)
        mode = single_mode(f_hz, zeta)
        z = mode.poles()[0]
        held = mode_of(quantised(mode, form).poles()[0])
        moved = np.array([abs(held[0] / f_hz - 1), abs(held[1] / zeta - 1)])
        bound = UNIT * (abs(z) if form == "modal" else abs(z - 1)) / abs(z) / (2 * np.pi * f_hz / RATE_HZ)
        worst = np.maximum(worst, moved)
        share = max(share, moved[0] / bound, moved[1] / (bound * (1 + 1 / zeta)))
    print(f"{form}: frequency within {worst[0]:.1e}, damping within {worst[1]:.1e}, {share:.2f} of the bound")
    assert share < 1.01


def test_polynomial_coefficients_would_not():
    law = single_mode(12.0, 0.02)
    coarse = np.poly(law.poles()).astype(np.float32)
    moved = mode_of(np.roots(coarse.astype(float))[0])
    held = mode_of(quantised(law, "modal").poles()[0])
    print(f"12 Hz in float32: {moved[0]:.4f} Hz from z^2 + a z + b, {held[0]:.6f} Hz from the modal block")
    assert abs(moved[0] - 12.0) > 100 * abs(held[0] - 12.0)


@pytest.mark.parametrize("form", ["modal", "delta", "schur"])
def test_running_sums_stay_with_the_float64_law(law_of, rng, tmp_path, form):
    law = law_of(48)
    y = rng.standard_normal((6, 6000))
    y *= 20.0 / np.abs(law.simulate(y)).max()
    twin = Twin(generate(law, tmp_path / "code", form=form).law)
    twin.reset()
    exact = law.simulate(y)
    error = np.linalg.norm(twin.run(y) - exact) / np.linalg.norm(exact)
    print(f"{form}: relative error of the commands {error:.1e}")
    assert error < 1e-3


def test_word_length_study_halves_the_error_with_each_bit(law_of):
    law = law_of(48)
    bits = (18, 22, 26, 30, 34, 38)
    errors = rounding_errors(law, bits)
    for form, each in errors.items():
        slope = np.polyfit(bits, np.log2(each), 1)[0]
        print(form, " ".join(f"{b}: {e:.0e}" for b, e in zip(bits, each, strict=True)), f"slope {slope:.2f}")
        assert -1.4 < slope < -0.6
    assert np.all(errors["delta"] < errors["modal"])


def test_word_length_24_is_float32(law_of, tmp_path):
    law = law_of(16)
    made = generate(law, tmp_path / "code", form="modal")
    assert rounding_errors(law, (24,))["modal"][0] == pytest.approx(made.tables["response_error"], rel=1e-6)


def test_word_length_leaves_out_a_form_that_does_not_exist(rng):
    delays = StateSpace(np.diag(np.ones(3), 1), np.ones((4, 1)), np.ones((1, 4)), [[0.0]], rate_hz=RATE_HZ)
    assert set(rounding_errors(delays)) == {"schur", "dense"}
    with pytest.raises(InputError, match="continuous time"):
        rounding_errors(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(InputError, match="'bits' must be between 1 and 53"):
        rounding_errors(delays, (64,))
