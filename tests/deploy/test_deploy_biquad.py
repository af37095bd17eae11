"""Banks: decentralised and decoupled laws as sections that each serve one channel."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ, random_law
from scipy.linalg import block_diag

import ultraquiet as uq
from ultraquiet.deploy import generate, kernel_cycles, realisation
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.fixed_point.word_lengths import multiply_adds
from ultraquiet.deploy.law.biquad import channels
from ultraquiet.deploy.law.form_choice import error_of
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.verification.verify import compare, measurements
from ultraquiet.values import StateSpace


def decentralised(rng, sizes, same=False, source=None, sink=None):
    """Channels of these sizes; the same law in each when `same`; between transforms when given."""
    first = random_law(rng, sizes[0], 1, 1)
    laws = [first if same else random_law(rng, n, 1, 1) for n in sizes]
    A, B, C, D = (block_diag(*[getattr(law, m) for law in laws]) for m in "ABCD")
    T = np.eye(len(sizes)) if source is None else source
    S = np.eye(len(sizes)) if sink is None else sink
    return StateSpace(A, B @ T, S @ C, S @ D @ T, rate_hz=RATE_HZ)


def rotated(rng, law):
    Q = np.linalg.qr(rng.standard_normal(law.A.shape))[0]
    return StateSpace(Q @ law.A @ Q.T, Q @ law.B, law.C @ Q.T, law.D, rate_hz=RATE_HZ)


@pytest.mark.parametrize("form", ["bank", "bank-delta", "modal", "delta"])
@pytest.mark.parametrize("same", [False, True])
def test_every_form_of_a_decentralised_law_is_the_law(rng, form, same):
    law = decentralised(rng, [9] * 6 if same else [4, 9, 2, 7, 1, 6], same)
    parts = realisation(law, form)
    error = error_of(parts.state_space(RATE_HZ), law)
    print(f"{form}, {'alike' if same else 'different'}: {error:.1e}, {parts.channels}")
    assert {b.shape for b in parts.blocks} == {(2, 2)}
    assert error < 1e-9
    if form == "bank":
        off = parts.B[np.repeat(np.arange(6), 2 * np.array(parts.channels))[:, None] != np.arange(6)]
        assert not off.any()


@pytest.mark.gate("alike-True-float32", "different-False-float64", "wide-False-float32")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("anti_windup", [False, True])
@pytest.mark.parametrize("kind", ["different", "alike", "decoupled", "wide"])
def test_bank_bit_for_bit(rng, seed, tmp_path, cc, kind, anti_windup, precision):
    sizes = [int(n) for n in rng.integers(1, 9, int(rng.integers(2, 7)))]
    m = len(sizes)
    wide = kind == "wide"
    turns = [rng.standard_normal((m, m + 2)), rng.standard_normal((m + 1, m))] if wide else [None, None]
    if kind == "decoupled":
        turns = [np.linalg.qr(rng.standard_normal((m, m)))[0] for _ in range(2)]
    law = decentralised(rng, [5] * m if kind == "alike" else sizes, kind == "alike", *turns)
    form = str(rng.choice(["bank", "bank-delta"]))
    made = generate(law, tmp_path / "code", precision, form=form, anti_windup=anti_windup, ramp_s=0.02)
    y = measurements(made.plan, 3000, seed)
    code, twin = CompiledController(Library(made.law, made.folder, cc), ramp=True), Twin(made.law)
    twin.enable()
    print(f"{form} {sizes} {kind}: {made.status}")
    assert compare(code.run(y), twin.run(y)) == (0, None)
    if kind == "decoupled" and anti_windup and precision == "float32":  # the one that also visits the targets
        found = made.verify(steps=3000, seed=seed)
        print(found.status)
        assert found.ok, found.status
    assert made.law.turned == (kind in ("decoupled", "wide"))
    # Rounding moves a pole by half a last place of z, which counts against its distance from the circle.
    room = 1.0 - np.abs(law.poles()).max(initial=0.0)
    assert made.tables["response_error"] < (1e-5 + 2.0**-22 / room if precision == "float32" else 1e-9 + 1e-14 / room)


def test_auto_takes_the_bank_and_it_costs_less(rng, tmp_path):
    law = decentralised(rng, [10] * 6, same=True)
    made = generate(law, tmp_path / "code")
    modal = kernel_cycles("modal", 60)
    print(f"60 states in six alike channels: {made.tables['c31_kernel_cycles']} C31 cycles, modal {modal}")
    assert made.tables["form"] == "bank"
    assert made.tables["c31_kernel_cycles"] == kernel_cycles("bank", 60)
    assert made.tables["c31_kernel_cycles"] < modal / 2
    assert multiply_adds(made.law) == 60 * (2 + 1 + 1) + 6


@pytest.mark.slow
def test_alike_design_of_the_demo_becomes_a_bank(tmp_path):
    ground = uq.bench.Hexapod(unit="ground").linear_model()
    law = uq.design.BandAttenuation(band_hz=(9.0, 108.0), structure="repeated").design(ground).controller
    made = generate(law, tmp_path / "code", plant=ground)
    dense = kernel_cycles("dense", law.states)
    modal = kernel_cycles("modal", law.states)
    print(
        f"{law.states} states: bank {made.tables['c31_kernel_cycles']}, modal {modal}, dense {dense} C31 cycles;"
        f" {made.status}"
    )
    assert made.tables["form"] == "bank"
    assert made.status.ok
    assert made.tables["c31_kernel_cycles"] < 6 * law.states  # a state of a bank takes five and a half
    assert realisation(law, "modal").blocks[0].shape == (2, 2)


def test_equal_poles_in_mixed_coordinates_still_make_pairs(rng):
    law = rotated(rng, decentralised(rng, [8] * 4, same=True))
    parts = realisation(law, "modal")
    error = error_of(parts.state_space(RATE_HZ), law)
    print(f"poles four times each, rotated: {error:.1e}, condition {parts.condition:.1e}")
    assert {b.shape for b in parts.blocks} == {(2, 2)}
    assert error < 1e-8


@pytest.mark.parametrize("kind", ["alike", "different", "decoupled"])
def test_channels_in_mixed_coordinates_are_found(rng, kind):
    m = 4
    turns = [np.linalg.qr(rng.standard_normal((m, m)))[0] for _ in range(2)] if kind == "decoupled" else [None, None]
    plain = decentralised(rng, [8, 8, 8, 8] if kind == "alike" else [3, 8, 6, 5], kind == "alike", *turns)
    law = rotated(rng, plain)
    parts = realisation(law, "bank")
    error = error_of(parts.state_space(RATE_HZ), law)
    least = kernel_cycles("bank", parts.states, m, m, turned=kind == "decoupled")
    print(f"{kind}: {parts.channels} blocks, {error:.1e}, {least} against {kernel_cycles('modal', 32, m, m)} cycles")
    assert sorted(parts.channels) == [4] * m if kind == "alike" else sorted(parts.channels) == [2, 3, 3, 4]
    assert (parts.turn_in is None) == (kind != "decoupled")
    assert error < 1e-6


def test_channel_without_states_and_states_without_use(rng):
    law = decentralised(rng, [4, 4])
    idle = block_diag(law.A, 0.5 * np.eye(3))
    B = np.vstack([np.hstack([law.B, np.zeros((4 + 4, 1))]), np.zeros((3, 3))])
    C = np.vstack([np.hstack([law.C, np.zeros((2, 3))]), np.zeros((1, 11))])
    D = block_diag(law.D, 0.7)
    found = channels(StateSpace(idle, B, C, D, rate_hz=RATE_HZ))
    assert [c.law.states for c in found] == [4, 4, 0]
    assert found[2].law.D[0, 0] == pytest.approx(0.7)
    parts = realisation(StateSpace(idle, B, C, D, rate_hz=RATE_HZ), "bank")
    assert parts.channels == (2, 2, 0)


def test_coupled_laws_are_refused_with_a_sentence(law_of, rng):
    with pytest.raises(ValueError, match=r"a bank needs channels of one measurement and one command, but 12 states"):
        realisation(law_of(12), "bank")
    law = decentralised(rng, [3, 3])
    crossed = StateSpace(law.A, law.B, law.C, law.D + np.array([[0.0, 0.1], [0.0, 0.0]]), rate_hz=RATE_HZ)
    found = realisation(crossed, "bank")
    assert len(found.channels) == 3  # the gain between channels is a channel of its own
    turned = StateSpace(law.A, law.B @ [[1.0, 1.0], [1.0, -2.0]], law.C, law.D + 0.3, rate_hz=RATE_HZ)
    with pytest.raises(ValueError, match=r"direct gain within its channels"):
        realisation(turned, "bank")
    with pytest.raises(ValueError, match="a bank needs states"):
        realisation(StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2), RATE_HZ), "bank")
