"""What must not leave `deploy`: a law lost in its coordinates, a plant, an unstable loop, code no compiler takes."""

import os
import shutil

import numpy as np
import pytest
import uq_command
from deploy_laws import RANGES, RATE_HZ, block, random_law

from ultraquiet import files
from ultraquiet._base.errors import InputError, NumericalError, ToolError
from ultraquiet._base.provenance import Provenance
from ultraquiet.cli.exits.codes import ExitCode, exit_code
from ultraquiet.deploy import generate, generate_fixed, word_lengths
from ultraquiet.deploy.law.coordinates import balanced
from ultraquiet.deploy.law.kind import require_law
from ultraquiet.design.loop_analysis import analyse_loop
from ultraquiet.values import Channel, StateSpace

F_HZ = np.geomspace(0.5, 1700.0, 60)


def rescaled(law, scale, into=1.0, out=1.0):
    """The law with states scaled, and inputs and outputs in other units."""
    s = np.asarray(scale)
    return StateSpace(
        law.A * s[:, None] / s, into * law.B * s[:, None], out * law.C / s, into * out * law.D, law.rate_hz
    )


def power_between(before, after):
    """Return the power of two by which each entry was multiplied, NaN where it is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before != 0, np.log2(np.abs(after / before)), np.nan)


def apart(one, other):
    a, b = (K.frequency_response(F_HZ) for K in (one, other))
    return np.abs(a - b).max() / np.abs(a).max()


def badly_scaled(rng, n=20):
    """Lightly damped modes of 5 to 1600 Hz in mixed coordinates, states scaled over twelve decades."""
    w = 2 * np.pi * np.exp(rng.uniform(np.log(5.0), np.log(1600.0), n // 2)) / RATE_HZ
    poles = np.exp(w * (-0.02 + 1j * np.sqrt(1 - 0.02**2)))
    A = np.zeros((n, n))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block(p)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    even = StateSpace(
        T @ A @ T.T, 0.1 * rng.standard_normal((n, 6)), rng.standard_normal((6, n)), np.zeros((6, 6)), RATE_HZ
    )
    return even, rescaled(even, 10.0 ** rng.uniform(-6, 6, n))


def shapes(rng):
    """Laws of many kinds: full, delays in a chain, triangular, separate modes, and a gain."""
    chain = StateSpace(np.eye(6, k=1), np.eye(6)[:, 5:], np.eye(6)[:1], [[0.0]], RATE_HZ)
    triangle = np.triu(0.3 * rng.standard_normal((7, 7)), 1) + np.diag(rng.uniform(-0.9, 0.9, 7))
    fallen = StateSpace(triangle, rng.standard_normal((7, 5)), rng.standard_normal((3, 7)), np.zeros((3, 5)), RATE_HZ)
    laws = [
        random_law(rng, n, nu, ny, mixed) for n, nu, ny in ((1, 1, 1), (8, 4, 3), (9, 3, 5)) for mixed in (True, False)
    ]
    return [*laws, chain, fallen, random_law(rng, 0, 2, 2)]


@pytest.mark.three_draws
def test_scaling_is_by_powers_of_two_and_changes_no_response(rng):
    for law in shapes(rng):
        for decades, into, out in ((0, 1.0, 1.0), (9, 1.0, 1.0), (30, 1e9, 1e-9), (30, 1e-9, 1e-9), (30, 1e9, 1e9)):
            # powers of two, so that this alone changes no digit of the law
            skewed = rescaled(law, 2.0 ** np.rint(3.3 * rng.uniform(-decades, decades, law.states)), into, out)
            even = balanced(skewed)
            for exact, moved in ((skewed.A, even.A), (skewed.B, even.B), (skewed.C, even.C)):
                ratio = np.abs(moved[exact != 0] / exact[exact != 0])
                assert np.array_equal(np.frexp(ratio)[0], np.full(ratio.shape, 0.5))  # the mantissas are untouched
                assert np.array_equal(np.signbit(moved), np.signbit(exact))
            assert np.array_equal(even.D, skewed.D)
            # each state has one power of two, whatever it meets: the same response, to the last digit
            powers = [power_between(*pair) for pair in ((skewed.A, even.A), (skewed.B, even.B), (skewed.C, even.C))]
            states = np.concatenate([powers[1], -powers[2].T], axis=1)
            own = np.array([next(iter(row[~np.isnan(row)]), np.nan) for row in states])
            across = own[:, None] - own
            assert np.all((states == own[:, None]) | np.isnan(states))
            assert np.all((powers[0] == across) | np.isnan(powers[0]) | np.isnan(across))


@pytest.mark.three_draws
def test_coordinates_and_units_do_not_decide_how_large_a_state_is(rng):
    """Whatever the states and channels were counted in, A is no larger than twice what the law was drawn with."""
    for law in shapes(rng)[:-1]:
        for decades, unit in ((0, 1.0), (12, 1.0), (12, 1e9), (12, 1e-9)):
            even = balanced(rescaled(law, 10.0 ** rng.uniform(-decades, decades, law.states), unit, unit))
            size, drawn = np.linalg.norm(even.A), np.linalg.norm(balanced(law).A)
            assert size < 4 * drawn, (law.states, law.D.shape, decades, unit, size, drawn)
            b, c = np.linalg.norm(even.B), np.linalg.norm(even.C)
            assert 2**-1.01 < b / c < 2**1.01


def test_a_badly_scaled_law_becomes_the_code_that_it_is_in_any_coordinates(rng, tmp_path, cc):
    even, bad = badly_scaled(rng)
    made = generate(bad, tmp_path / "code")
    off = apart(even, made.quantised)
    print(f"{made.status} From the law as it was drawn: {off:.1e}")
    assert made.status.ok
    assert made.quantised.is_stable()
    assert off < 5e-3
    assert made.verify(500, targets=(), fuzz_steps=0).ok


@pytest.mark.slow
def test_a_badly_scaled_law_on_the_command_line(rng, tmp_path, cc, monkeypatch, capsys):
    even, bad = badly_scaled(rng)
    told = [generate(law, tmp_path / "code").tables["response_error"] for law in (even, bad)]
    assert told[1] < 2 * told[0]
    files.save(bad, tmp_path / "law.h5")
    words = ("--target", "none", "--steps", "500")
    code, out, _ = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "law.h5", *words)
    print(out[-400:])
    assert code == 0
    assert "ok: All bits of 500 steps" in out
    assert word_lengths(bad, precisions=("float32",))[0].status.ok


@pytest.mark.slow
def test_float64_code_of_a_badly_scaled_law_is_exact(rng, tmp_path):
    even, bad = badly_scaled(rng)
    assert apart(even, generate(bad, tmp_path / "code", "float64").quantised) < 1e-9


PLANTS = {
    "identified": {"provenance": Provenance("box-jenkins")},
    "a bench's own": {"provenance": Provenance("bench.hexapod.linear_model")},
    "motion comes out": {"sensors": [Channel("z", "m/s²")]},
    "words": {"actuators": [Channel("shaker 1")], "sensors": [Channel("geophone 1")]},
}


@pytest.mark.parametrize("how", PLANTS)
def test_a_plant_is_refused_in_place_of_a_law(tmp_path, how, monkeypatch, capsys):
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ, **PLANTS[how])
    calls = (
        lambda: generate(plant, tmp_path / "c"),
        lambda: generate_fixed(plant, tmp_path / "c"),
        lambda: word_lengths(plant),
    )
    for call in calls:
        with pytest.raises(InputError, match="this is a plant, not a law: "):
            call()
    files.save(plant, tmp_path / "plant.h5")
    code, _, err = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "plant.h5", "--out", tmp_path / "c")
    print(err)
    assert (code, "a plant" in err) == (2, True)
    assert os.listdir(tmp_path) == ["plant.h5"]


def of_active_struts(ny, nu, **settings):
    """A diagonal law that measures forces and commands motions, and a plant whose channels it mirrors."""
    forces = [Channel(f"force {k}", "N", -10, 10) for k in range(ny)]
    motions = [Channel(f"piezo {k}", "µm", -10, 10) for k in range(nu)]
    D = -0.1 * np.eye(nu, ny)
    law = StateSpace(0.5 * np.eye(nu), 0.1 * np.eye(nu, ny), np.eye(nu), D, RATE_HZ, forces, motions, **settings)
    plant = StateSpace(0.9 * np.eye(ny), 0.1 * D.T, np.eye(ny), np.zeros((ny, nu)), RATE_HZ, motions, forces)
    return law, plant


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
def test_forces_that_command_motions_are_a_law_beside_its_plant_and_from_a_design(tmp_path, ny, nu):
    law, plant = of_active_struts(ny, nu)
    designed, _ = of_active_struts(ny, nu, provenance=Provenance("Lqg"))
    synthesised, _ = of_active_struts(ny, nu, provenance=Provenance("synthesize_hinf"))
    assert generate(law, tmp_path / "code", plant=plant).status.ok
    for given in (designed, synthesised):
        require_law(given)
    with pytest.raises(InputError, match="told from a plant by that of its loop: give `plant`"):
        require_law(law)


def test_a_law_of_forces_to_a_velocity_command_is_told_by_the_names_of_its_plant():
    into, out = [Channel("force 1", "V")], [Channel("velocity command", "V")]
    law = StateSpace([[0.5]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ, into, out)
    require_law(law, StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ, out, into))
    with pytest.raises(InputError, match="'force 1' goes in and 'velocity command' comes out"):
        require_law(law)


def test_a_plant_and_its_law_in_each_others_place_are_told_by_who_made_the_law():
    coils, geophones = [Channel("coil 1", "V")], [Channel("geophone 1", "m/s")]
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ, coils, geophones)
    law = StateSpace([[0.5]], [[0.1]], [[1.0]], [[0.0]], RATE_HZ, geophones, coils, provenance=Provenance("lqg"))
    require_law(law, plant)
    with pytest.raises(InputError, match="'coil 1' in V goes in and 'geophone 1' in m/s comes out"):
        require_law(plant, law)


@pytest.mark.slow
def test_the_plant_of_the_loop_is_no_law_and_a_law_is_no_plant(tmp_path):
    names = {"actuators": ["left", "right"], "sensors": ["near", "far"]}
    G = StateSpace(0.9 * np.eye(2), 0.1 * np.eye(2), np.eye(2), np.zeros((2, 2)), RATE_HZ)
    named = StateSpace(0.8 * np.eye(2), 0.1 * np.eye(2), np.eye(2), np.zeros((2, 2)), RATE_HZ, **names)
    other = StateSpace(0.7 * np.eye(2), 0.1 * np.eye(2), np.eye(2), np.zeros((2, 2)), RATE_HZ, **names)
    for given, plant in ((G, G), (other, named)):
        with pytest.raises(InputError, match="this is a plant, not a law"):
            generate(given, tmp_path / "code", plant=plant)
    law = StateSpace(
        0.5 * np.eye(2),
        0.1 * np.eye(2),
        -0.1 * np.eye(2),
        np.zeros((2, 2)),
        RATE_HZ,
        ["near", "far"],
        ["left", "right"],
    )
    velocity = [Channel(f"geophone {k}", "m/s") for k in (1, 2)]
    heard = StateSpace(law.A, law.B, law.C, law.D, RATE_HZ, velocity, ["shaker 1", "shaker 2"])
    designed = StateSpace(law.A, law.B, law.C, law.D, RATE_HZ, provenance=Provenance("Lqg"))
    for each in (law, heard, designed):
        assert generate(each, tmp_path / "code", plant=named).status.ok


def test_a_law_that_rounding_makes_unstable_is_refused(tmp_path, monkeypatch, capsys):
    law = StateSpace([[1.0 - 2e-9]], [[0.1]], [[0.1]], [[0.0]], RATE_HZ)
    with pytest.raises(NumericalError, match=r"0\.999999998 as designed, 1\.000000000 rounded; nothing was written"):
        generate(law, tmp_path / "code", form="modal")
    assert generate(law, tmp_path / "kept").tables["form"] == "delta"
    shutil.rmtree(tmp_path / "kept")
    files.save(law, tmp_path / "law.h5")
    words = ("deploy", tmp_path / "law.h5", "--form", "dense")
    code, _, err = uq_command.called(monkeypatch, capsys, *words)
    print(err)
    assert (code, "the law is stable, not so its float32 coefficients in dense form" in err) == (1, True)
    assert os.listdir(tmp_path) == ["law.h5"]


def test_a_loop_that_rounding_upsets_is_refused(tmp_path, monkeypatch, capsys):
    plant = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)
    # y+ = 0.5 y + u with u = -(1.5 - 1e-9) y has its pole 1e-9 inside the circle; float32 holds 1.5 of it.
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1.5 + 1e-9]], RATE_HZ)
    files.save(law, tmp_path / "law.h5")
    files.save(plant, tmp_path / "plant.h5")
    ranged = ("--precision", "q15", "--range", "10", "--limits", "25")
    for make, words, settings in ((generate, (), {}), (generate_fixed, ranged, {"word": "q15", **RANGES})):
        with pytest.raises(NumericalError, match="unstable, rounded, not as designed"):
            make(law, tmp_path / "code", plant=plant, **settings)
        call = ("deploy", tmp_path / "law.h5", "--plant", tmp_path / "plant.h5", "--out", tmp_path / "code", *words)
        code, _, err = uq_command.called(monkeypatch, capsys, *call)
        print(err)
        assert (code, "the loop of this plant and the law is unstable" in err) == (1, True)
    assert sorted(os.listdir(tmp_path)) == ["law.h5", "plant.h5"]


def test_code_of_a_law_that_is_unstable_by_itself_is_written_and_said_to_be(tmp_path):
    """A plant may need such a law; without a loop that holds it it is not ok, and the command ends with one."""
    law = StateSpace([[1.1]], [[1.0]], [[-0.5]], [[0.0]], RATE_HZ)
    status = generate(law, tmp_path / "code").status
    assert (status.word, exit_code(status)) == ("unstable", ExitCode.NOT_OK)
    assert "The controller itself is unstable" in status.sentence
    assert (tmp_path / "code" / "manifest.json").exists()
    plant = StateSpace([[0.3]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)
    held = generate(law, tmp_path / "held", plant=plant).status
    print(held)
    assert held.ok
    assert "The controller itself is unstable" in held.sentence
    said = analyse_loop(plant, law, (1.0, 50.0)).status
    print(said)
    assert "The controller is unstable by itself" in said.sentence


@pytest.mark.skipif(os.name != "posix", reason="the compilers are shell scripts")
def test_code_that_no_compiler_takes_is_refused_and_not_written(law_of, tmp_path, monkeypatch, capsys):
    law = law_of(4)
    generate(law, tmp_path / "code")
    before = (tmp_path / "code" / "manifest.json").read_bytes()
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("cc", "gcc", "clang"):
        (tools / name).write_text("#!/bin/sh\necho 'controller.c:7: error: no such thing' >&2\nexit 1\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tools))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(ToolError, match=r"refused the generated code: .* error: no such thing"):
        generate(law, tmp_path / "code")
    assert (tmp_path / "code" / "manifest.json").read_bytes() == before
    files.save(law, tmp_path / "law.h5")
    code, _, err = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "law.h5", "--out", tmp_path / "new")
    print(err)
    assert (code, "no such thing" in err) == (1, True)
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_code_that_does_not_do_what_the_law_does_ends_with_one_and_exports_nothing(
    law_of, tmp_path, cc, monkeypatch, capsys
):
    from ultraquiet.deploy import deployment

    real = deployment.verify_code

    def spoilt(made, *words):
        (made.folder / "controller.c").write_text("int x = ;\n")
        return real(made, *words)

    monkeypatch.setattr(deployment, "verify_code", spoilt)
    files.save(law_of(4), tmp_path / "law.h5")
    words = ("--target", "none", "--fmu", tmp_path / "law.fmu", "--project", tmp_path / "project")
    code, out, err = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "law.h5", *words)
    print(out, err)
    assert (code, "not compiled: " in out) == (1, True)
    assert sorted(os.listdir(tmp_path)) == ["law", "law.h5"]
