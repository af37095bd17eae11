"""Whole numbers: no overflow by proof and by the worst measurements there are, the same words in C, honest refusals."""

import subprocess

import numpy as np
import pytest
from deploy_laws import RANGES, RATE_HZ, block, random_law

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import FixedTwin, fixed_law, generate_fixed, word_lengths
from ultraquiet.deploy.fixed_point.deployment import measurements
from ultraquiet.deploy.fixed_point.state_bounds import peaks
from ultraquiet.deploy.fixed_point.twin import words
from ultraquiet.deploy.law.form_choice import error_of
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.values import StateSpace

EVERY = [(w, f, s) for w in ("q31", "q15") for f in ("modal", "delta") for s in ("l1", "l2")]


def damped(rng, states, inputs=3, outputs=2):
    """A law that Q15 can hold: modes from 30 Hz on."""
    f_hz = rng.uniform(30.0, 400.0, states // 2)
    s = 2 * np.pi * f_hz * (-0.3 + 0.95j)
    A = np.zeros((states, states))
    for k, p in enumerate(np.exp(s / RATE_HZ)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block(p)
    B, C = (0.2 * rng.standard_normal(shape) for shape in ((states, inputs), (outputs, states)))
    return StateSpace(A, B, C, 0.2 * rng.standard_normal((outputs, inputs)), rate_hz=RATE_HZ)


@pytest.mark.gate("q15-modal-l1", "q31-delta-l2")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize(("word", "form", "scaling"), EVERY)
def test_words_of_the_code_are_the_twin_s(rng, seed, tmp_path, word, form, scaling):
    law = damped(rng, int(rng.integers(1, 8)) * 2, int(rng.integers(1, 7)), int(rng.integers(1, 7)))
    made = generate_fixed(
        law, tmp_path / "code", word, form=form, scaling=scaling, ramp_s=0.02, tolerance=1.0, **RANGES
    )
    found = made.verify(steps=2000, seed=seed)
    print(f"{word} {form} {scaling}: {found.status}")
    assert found.ok, found.status
    assert found.bit_exact is True


@pytest.mark.parametrize(("word", "form"), [(w, f) for w in ("q31", "q15") for f in ("modal", "delta")])
def test_the_worst_measurements_reach_the_bound_and_do_not_pass_it(rng, word, form):
    law = fixed_law(damped(rng, 8), word, form, **RANGES)
    A, B, _, _ = law.fractions()
    top = 2 ** (law.bits - 1) - 1
    steps, share = 600, []
    powers = np.stack([np.linalg.matrix_power(A, t) @ B for t in range(steps)])
    for k in range(law.states):
        worst = np.sign(powers[::-1, k, :]).T  # y(-t) that adds up every |h(t)|
        twin = FixedTwin(law)
        twin.reset()
        twin.run((worst * top).astype(np.int64))
        share.append(abs(int(twin.x[k])) / top)
        assert np.all(np.abs(twin.x) <= top)
    print(f"{word} {form}: worst drive fills {max(share):.4f} of the range, bound {law.peak:.4f}")
    assert 0.9 * law.peak < max(share) <= law.peak


@pytest.mark.gate("q31-modal-l2", "q15-delta-l1")
@pytest.mark.parametrize(("word", "form", "scaling"), EVERY)
def test_laws_of_any_loudness_are_written_or_refused_in_a_sentence(rng, tmp_path, word, form, scaling):
    """Sums of very quiet ones go down by all places of the accumulator but one; nothing leaves 64 bits on the way."""
    fates, refusals = [], []
    for loudness in 10.0 ** -np.arange(-2.0, 17.0, 2.0):
        law = random_law(rng, int(rng.integers(1, 7)), 2, 2)
        law = StateSpace(law.A, law.B, loudness * law.C, loudness * law.D, rate_hz=RATE_HZ)
        try:
            made = generate_fixed(
                law, tmp_path / "code", word, form=form, scaling=scaling, tolerance=1.0, ramp_s=0.01, **RANGES
            )
            fates.append(int((made.law.shift_u + made.law.bits - 2).max()))
        except InputError as refusal:
            refusals.append(str(refusal))
    print(f"{word} {form} {scaling}: commands go down by {fates} places, {len(refusals)} laws refused")
    assert fates
    assert refusals
    assert all(said.startswith(("generate_fixed: ", "fixed_law: ")) for said in refusals)


@pytest.mark.gate("q15-modal-l2", "q31-delta-l1")
@pytest.mark.parametrize(("word", "form", "scaling"), EVERY)
def test_noise_of_rounding_is_what_is_stated(rng, word, form, scaling):
    law = damped(rng, 8)
    made = fixed_law(law, word, form, scaling=scaling, output_v=400.0, input_v=10.0)
    twin = FixedTwin(made)
    twin.reset()
    y = words(rng.uniform(-0.5, 0.5, (3, 4000)) * made.input_v / 8, made.input_v, made.bits)
    got = twin.run(y) * made.output_v / 2.0 ** (made.bits - 1)
    exact = made.state_space().simulate(y * made.input_v / 2.0 ** (made.bits - 1))
    rms = np.sqrt(np.mean((got - exact) ** 2, axis=1))
    ratio, worst = rms / made.noise_v, np.abs(got - exact).max(axis=1) / made.noise_bound_v
    print(
        f"{word} {form} {scaling}: rms {ratio.min():.2f} to {ratio.max():.2f} of that stated, {worst.max():.2f} bound"
    )
    assert twin.clipped == 0
    assert np.all((ratio > 0.8) & (ratio < 1.25))
    assert np.all(worst < 1.0)


def test_sums_stay_within_the_accumulator(rng):
    for word, form, scaling in EVERY:
        law = fixed_law(damped(rng, 12), word, form, scaling=scaling, **RANGES)
        half = 2 ** (law.bits - 1)
        for rows in (law.A.reshape(-1, 2), law.B, np.concatenate([law.D.T, law.C]).T):
            assert np.abs(rows).sum(axis=1).max() * half <= 2 ** (2 * law.bits - 2)
        assert law.accumulator < 1.0


@pytest.mark.parametrize("word", ["q31", "q15"])
def test_no_undefined_arithmetic_whatever_comes_in(rng, seed, tmp_path, cc, word):
    """The sanitizer sees every signed overflow and bad shift: full-range squares, noise and silence."""
    made = generate_fixed(damped(rng, 10), tmp_path / "code", word, tolerance=1.0, ramp_s=0.02, **RANGES)
    law = made.law
    y = measurements(law, 3000, seed).T
    main = tmp_path / "main.c"
    rows = ",\n".join("{" + ",".join(str(int(v)) for v in row) + "}" for row in y)
    main.write_text(
        f'#include "controller.h"\nstatic const controller_word Y[{len(y)}][{law.inputs}] = {{\n{rows}\n}};\n'
        "int main(void)\n{\n    controller_state s;\n    controller_word u[CONTROLLER_OUTPUTS];\n"
        "    controller_init(&s);\n    controller_enable(&s);\n"
        f"    for (int k = 0; k < {len(y)}; k++) {{\n        controller_output(&s, Y[k], u);\n"
        "        controller_update(&s);\n    }\n    return 0;\n}\n"
    )
    flags = ["-fsanitize=undefined,signed-integer-overflow,shift", "-fno-sanitize-recover=all", "-g", "-O1"]
    program = tmp_path / "fuzz"
    command = [cc, "-std=c99", *flags, f"-I{made.folder}", main, made.folder / "controller.c", "-o", program]
    built = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if built.returncode != 0 and "ubsan" in built.stderr:
        pytest.skip("this compiler has no undefined-behaviour sanitizer")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    print(f"{word}: {len(y)} steps, sanitizer said {ran.stderr!r}")
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize("word", ["q31", "q15"])
def test_code_has_no_floating_point_and_no_warning(rng, tmp_path, cc, word):
    made = generate_fixed(damped(rng, 6), tmp_path / "code", word, tolerance=1.0, **RANGES)
    text = (made.folder / "controller.c").read_text().split("*/", 1)[1]
    assert "float" not in text
    assert "double" not in text
    for source in ("controller.c", "controller_selftest.c"):
        command = [cc, *FLAGS, "-Wshadow", "-Wpedantic", "-fsyntax-only", source]
        told = subprocess.run(command, cwd=made.folder, capture_output=True, text=True, check=False)
        assert told.returncode == 0, told.stderr


@pytest.mark.gate("change0", "change3", "change6", "change9")
@pytest.mark.parametrize(
    "change",
    [
        ("held > TOP", "held > (2 * (wide)TOP)"),
        ("held = -TOP", "held = TOP"),
        ("s->clipped = s->clipped + 1U", "s->clipped = s->clipped"),
        ("s->level = s->level - 1U", "s->level = 0U"),
        ("s->level = s->level + 1U", "s->level = s->level + 2U"),
        ("s->on = false;\n}\n\nstatic", "s->on = true;\n}\n\nstatic"),
        ("(one << (s - 1U)) + ", ""),
        ("if ((!s->on) && (s->level == 0U)) {", "if (false) {"),
        ("s->limited = s->limited + 1U", "s->limited = 0U"),
        ("s->x[k] = within(next_p, &met)", "s->x[k] = (word)next_p"),
        ("DOWN_B[k])", "DOWN_B[k] + 1U)"),
        ("u[i] = (word)rounded(u[i] * (wide)s->level", "u[i] = (word)rounded(u[i] * (wide)1"),
    ],
)
def test_self_test_catches_a_mutant(rng, tmp_path, cc, change):
    law = damped(rng, 6)
    loud = StateSpace(law.A, law.B, 20.0 * law.C, 20.0 * law.D, rate_hz=RATE_HZ)
    made = generate_fixed(loud, tmp_path / "code", "q15", scaling="l2", ramp_s=0.02, tolerance=1.0, **RANGES)
    source = made.folder / "controller.c"
    text = source.read_text()
    assert change[0] in text
    source.write_text(text.replace(change[0], change[1], 1))
    found = made.verify(steps=10)
    print(f"{change[0]!r}: {found.status.word}")
    assert found.self_test is False


def test_controller_runs_the_law_in_volts(rng, tmp_path):
    law = damped(rng, 8)
    made = generate_fixed(law, tmp_path / "code", "q31", output_v=100.0, input_v=10.0)
    y = rng.uniform(-5.0, 5.0, (400, 3))
    made.controller.reset()
    got = np.stack([made.controller.step(k) for k in y], axis=1)
    exact = law.simulate(y.T)
    error = np.abs(got - exact).max() / np.abs(exact).max()
    print(f"q31 against float64: {error:.1e}; {made.status}")
    assert made.controller.rate_hz == RATE_HZ
    assert error < 1e-6


def test_peaks_are_those_of_the_impulse_response(rng):
    law = damped(rng, 6)
    A = np.stack([law.A[k : k + 2, k : k + 2] for k in (0, 2, 4)])
    B = law.B.reshape(3, 2, -1)
    slow = 0.99999 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None] * A
    for blocks, samples in ((A, 4000), (slow, 400_000)):
        total, now = np.zeros((3, 2)), B.copy()
        for _ in range(samples):
            total += np.abs(now).sum(axis=2)
            now = blocks @ now
        bound = peaks(blocks, B)
        print(f"bound over sum: {(bound / total).min():.6f} to {(bound / total).max():.4f}")
        assert np.all(bound >= total * (1 - 1e-9))
        assert np.all(bound <= total * 1.7)  # pi/2 from |cos|, more where a response begins at its crest


def test_refusals_say_what_would_do(law_of, rng, tmp_path):
    folder = tmp_path / "code"
    integrator = StateSpace([[1.0]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    with pytest.raises(InputError, match=r"a pole of magnitude 1.000000000 gives states no bound"):
        generate_fixed(integrator, folder, **RANGES)
    slow = StateSpace(np.diag([1 - 1e-7, 0.5]), [[1e-3], [0.1]], [[1e-3, 0.1]], [[0.0]], rate_hz=RATE_HZ)
    with pytest.raises(InputError, match=r"coefficients in modal form are not; take form='delta' or q31"):
        generate_fixed(slow, folder, "q15", form="modal", **RANGES)
    with pytest.raises(InputError, match=r"coefficients in delta form are not; take q31"):
        generate_fixed(slow, folder, "q15", **RANGES)
    # forty lightly damped states cannot be held by 16 bits; which of the limits is met first depends on the draw
    limits = ("rounding alone could carry .*", "form are not", "too much for a word of 16 bits", "more than 0.005")
    with pytest.raises(InputError, match=rf"({'|'.join(limits)}); take q31"):
        generate_fixed(law_of(40), folder, "q15", **RANGES)
    loud = StateSpace([[0.5]], [[0.1]], [[1.0]], [[1e5]], rate_hz=RATE_HZ)
    with pytest.raises(InputError, match=r"too much for a word of 16 bits; take q31 or a larger output_v"):
        generate_fixed(loud, folder, "q15", **RANGES)
    with pytest.raises(InputError, match="'word' must be one of"):
        generate_fixed(law_of(4), folder, "q7", **RANGES)
    with pytest.raises(InputError, match="discrete time"):
        fixed_law(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert not folder.exists()


def test_q31_holds_what_the_bench_gets(law_of):
    law = law_of(48)
    made = fixed_law(law, "q31", "modal", **RANGES)
    error = error_of(made.state_space(), law)
    print(f"48 lightly damped states from 0.5 Hz: error {error:.1e}, noise {made.noise_v.max():.1e} V, {made.peak:.4f}")
    assert error < 5e-3
    assert made.peak <= 1.0


def test_word_lengths_rank_and_judge_the_loop(rng, law_of):
    plant = random_law(rng, 12)
    law = law_of(18)
    size = np.abs(law.frequency_response(np.geomspace(0.1, 1750, 500))).max()
    size *= np.abs(plant.frequency_response(np.geomspace(0.1, 1750, 500))).max()
    louder = StateSpace(law.A, law.B, 1e3 * law.C, 1e3 * law.D, rate_hz=RATE_HZ)
    with pytest.raises(InputError, match="the loop with the controller as it is has a pole of magnitude"):
        word_lengths(louder, plant)
    law = StateSpace(law.A, law.B, -0.05 / size * law.C, -0.05 / size * law.D, rate_hz=RATE_HZ)
    rows = word_lengths(law, plant, input_v=10.0, output_v=0.1)
    print("\n".join(map(str, rows)))
    best = {p: next(r for r in rows if r.precision == p) for p in ("float64", "float32", "q31", "q15")}
    assert all(best[p].status.ok for p in ("float64", "float32"))
    assert best["float64"].error < 1e-6
    assert best["float64"].degradation_db < 1e-4
    assert best["float32"].loop_radius < 1.0
    assert {r.form for r in rows if r.status.word == "refused" and r.precision == "float64"} == {"bank", "bank-delta"}
    for r in rows:
        if r.precision == "q31" and r.status.word != "refused" and "l2" not in r.form:
            assert r.overflow <= 1.0
    with pytest.raises(InputError, match="'precisions' must be one of"):
        word_lengths(law, precisions=("q63",))
    with pytest.raises(InputError, match="discrete time"):
        word_lengths(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))


def test_unstable_rounded_loop_is_said_to_be(rng):
    # 0.9999999 becomes 1 in float32.
    law = StateSpace(np.diag([1 - 1e-8, 0.5]), [[1e-4], [0.1]], [[1e-4, 0.1]], [[0.0]], rate_hz=RATE_HZ)
    plant = StateSpace([[0.5]], [[0.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    rows = {(r.precision, r.form): r for r in word_lengths(law, plant, precisions=("float32", "q15"), **RANGES)}
    print("\n".join(map(str, rows.values())))
    assert rows["float32", "modal"].status.word == "unstable"
    assert rows["float32", "modal"].degradation_db == np.inf
    assert rows["float32", "delta"].status.ok
    assert rows["q15", "modal"].status.word == "refused"


def test_a_converter_saturates_and_has_no_code_for_nan():
    for bits in (16, 32):
        top = 2 ** (bits - 1) - 1
        codes = words([15.0, -15.0, np.inf, -np.inf, 5.0], 10.0, bits)
        assert codes.tolist() == [top, -top, top, -top, 2 ** (bits - 2)]
        with pytest.raises(InputError, match="a measurement that is NaN has no code"):
            words([1.0, np.nan], 10.0, bits)
