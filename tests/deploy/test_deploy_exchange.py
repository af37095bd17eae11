"""A law's coefficients in the files of other programs, read back."""

import re

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.signal
from deploy_laws import RATE_HZ, block, random_law
from scipy.linalg import block_diag

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.deploy import generate
from ultraquiet.deploy.exchange.exchange import export_law, read_law
from ultraquiet.deploy.exchange.foton import foton_text, read_foton, response_error
from ultraquiet.values import Channel, Record, StateSpace

F_HZ = np.geomspace(0.5, 0.499 * RATE_HZ, 300)
ROUNDING = np.finfo(float).eps
ARRANGEMENTS = ["cascade", "sum"]


def apart(laws):
    """One law of scalar ones side by side: a decentralised controller."""
    return StateSpace(*(block_diag(*[getattr(one, m) for one in laws]) for m in "ABCD"), rate_hz=RATE_HZ)


def modes(rng, lowest_hz, highest_hz, count, least_damping):
    """A scalar law of random modes."""
    f_hz = np.exp(rng.uniform(np.log(lowest_hz), np.log(highest_hz), count))
    zeta = rng.uniform(least_damping, 0.7, count)
    poles = np.exp(2 * np.pi * f_hz * (-zeta + 1j * np.sqrt(1 - zeta**2)) / RATE_HZ)
    A = block_diag(*map(block, poles))
    B, C = rng.standard_normal((2 * count, 1)), rng.standard_normal((1, 2 * count))
    return StateSpace(A, B, C, rng.standard_normal((1, 1)), rate_hz=RATE_HZ)


def worst(law, back):
    """Largest difference of two responses, relative to the law's at that frequency."""
    a, b = law.frequency_response(F_HZ), back.frequency_response(F_HZ)
    return np.max(np.linalg.norm(a - b, axis=(0, 1)) / np.linalg.norm(a, axis=(0, 1)))


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".csv"])
def test_every_bit_comes_back(suffix, law_of, rng, tmp_path):
    for states, ny, nu in [(60, 6, 6), (7, 2, 3), (1, 1, 1), (0, 3, 2)]:
        plain = law_of(states, ny, nu)
        wires = [Channel(f"geophone {j}", "V") for j in range(ny)], [Channel(f"süd, {i}", "A") for i in range(nu)]
        rate_hz = float(rng.uniform(100, 1e4))
        law = StateSpace(plain.A, plain.B, plain.C, plain.D, rate_hz, *wires)
        back = read_law(export_law(law, tmp_path / f"law{suffix}"))
        for name in "ABCD":
            assert np.array_equal(getattr(back, name), getattr(law, name))
            assert getattr(back, name).shape == getattr(law, name).shape
        assert back.rate_hz == rate_hz
        assert [(c.name, c.unit) for c in (*back.actuators, *back.sensors)] == [
            (c.name, c.unit) for c in (*law.actuators, *law.sensors)
        ]
        if states:
            error = worst(law, back)
            print(f"{suffix}, {states} states: response equal to {error:.1e}, target 1e-12")
            assert error <= 1e-12


def test_other_programs_find_what_they_look_for(law_of, tmp_path):
    law = law_of(5, 2, 3)
    held = scipy.io.loadmat(export_law(law, tmp_path / "law.mat"), simplify_cells=True)
    system = scipy.signal.dlti(held["A"], held["B"], held["C"], held["D"], dt=held["Ts"])
    u = np.ones((40, 2))
    assert np.allclose(scipy.signal.dlsim(system, u)[1].T, law.simulate(u.T), rtol=0, atol=1e-12)
    assert list(held["input_names"]) == [c.name for c in law.actuators]
    with h5py.File(export_law(law, tmp_path / "law.h5")) as file:
        found = []
        file.visititems(lambda name, item: found.append((name, item.shape)) if hasattr(item, "shape") else None)
    assert any(name.endswith("A") and shape == (5, 5) for name, shape in found)


def test_the_code_s_own_coefficients_can_be_given(law_of, tmp_path):
    made = generate(law_of(12), tmp_path / "code")
    back = read_law(export_law(made.quantised, tmp_path / "law.mat"))
    assert np.array_equal(back.A, made.quantised.A)
    assert np.array_equal(np.float32(back.D), back.D)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_foton_holds_a_decentralised_law_whose_poles_lie_away_from_one_to_1e_12(arrangement, rng, tmp_path):
    """The format's own limit, eps / (2 zeta (2 pi f / rate)^2), is below 1e-13 for these modes."""
    law = apart([modes(rng, 200.0, 900.0, 3, 0.2) for _ in range(6)])
    path = export_law(law, tmp_path / "law.txt", arrangement=arrangement)
    error = response_error(law, read_foton(path.read_text()))
    print(f"foton {arrangement}, 36 states above 200 Hz: response equal to {error:.1e}, target 1e-12")
    assert error <= 1e-12
    assert worst(law, read_law(path)) <= 1e-10  # through a state space, solved anew at each frequency


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize("proper", [True, False])
def test_foton_holds_bench_laws_to_what_its_two_coefficients_can(arrangement, proper, rng):
    """Modes down to 0.5 Hz at 3.5 kHz: a1 and a2 rounded to float64 bound the response, whatever the writer does."""
    laws = [random_law(rng, 10, 1, 1) for _ in range(6)]
    law = apart([StateSpace(x.A, x.B, x.C, x.D * proper, rate_hz=RATE_HZ) for x in laws])
    p = law.poles()
    # |d(1 + a1/z + a2/z^2)| <= 2 eps on the unit circle, against |z - p| |z - p*| at its least, near the pole.
    bound = np.max(2 * ROUNDING / ((1 - abs(p)) * np.maximum(abs(1 - p**2), 1 - abs(p))))
    back = read_foton(foton_text(law, arrangement=arrangement))
    error = response_error(law, back)
    print(f"foton {arrangement}, direct gain {proper}: response equal to {error:.1e}, format allows {bound:.1e}")
    assert error <= 3 * bound  # numerators are rounded like denominators
    assert len(back.modules) == 6 if arrangement == "cascade" else len(back.modules) == 6 * (5 + proper)
    assert worst(law, back.state_space()) <= 1e-6


def test_channels_alike_are_modules_alike(rng):
    """A decentralised law with the same filter at every strut: each pole stands six times."""
    one = modes(rng, 5.0, 300.0, 4, 0.05)
    text = foton_text(apart([one] * 6))
    heads = [line.split()[7:] for line in text.splitlines() if line.startswith("CONTROLLER")]
    assert len(heads) == 6
    assert all(words == heads[0] for words in heads)


def test_a_cascade_runs_as_the_front_ends_run_it(rng):
    """Direct form II, sample by sample, from the numbers in the file alone."""
    law = modes(rng, 5.0, 300.0, 12, 0.02)
    text = foton_text(law, "ham 1".replace(" ", "_"))
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    heads = [words for words in lines if len(words) == 12]
    assert [(w[0], w[1], w[2], w[3], w[6]) for w in heads] == [
        ("HAM_1_U1_Y1", "0", "21", "10", "FM1"),
        ("HAM_1_U1_Y1", "1", "21", "2", "FM2"),
    ]
    assert "# SAMPLING RATE 3500" in text
    assert "# MODULES HAM_1_U1_Y1" in text
    x = rng.standard_normal(400)
    out = x.copy()
    for words in lines:
        gain, (a1, a2, b1, b2) = (float(words[7]) if len(words) == 12 else 1.0), map(float, words[-4:])
        h1 = h2 = 0.0
        for k, value in enumerate(out):
            new = value * gain - a1 * h1 - a2 * h2
            out[k] = new + b1 * h1 + b2 * h2
            h1, h2 = new, h1
    wanted = law.simulate(x[None])[0]
    error = np.abs(out - wanted).max() / np.abs(wanted).max()
    print(f"24 states as a chain of 12 sections in the time domain: equal to {error:.1e}")
    assert error < 1e-8


def test_matrices_stand_around_a_decoupled_law(rng):
    """Channels between combinations of measurements and commands: LIGO's input and output matrices."""
    T, S = rng.standard_normal((3, 4)), rng.standard_normal((5, 3))
    inner = apart([modes(rng, 10.0, 300.0, 2, 0.05) for _ in range(3)])
    law = StateSpace(inner.A, inner.B @ T, S @ inner.C, S @ inner.D @ T, rate_hz=RATE_HZ)
    back = read_foton(foton_text(law))
    assert [m.name for m in back.modules] == [f"CONTROLLER_C{k}" for k in (1, 2, 3)]
    assert response_error(law, back) < 1e-9


def test_a_law_that_couples_its_channels_is_refused_and_can_be_asked_for(law_of, tmp_path):
    law, path = law_of(6, 2, 3), tmp_path / "law.txt"
    words = "it would take 6 filters of 6 states each, one for every pair of measurement and command"
    with pytest.raises(InputError, match=words) as refused:
        export_law(law, path)
    print(refused.value)
    assert not path.exists()
    back = read_foton(export_law(law, path, coupled=True, arrangement="sum").read_text())
    assert len(back.modules) == 6 * (3 + 1)
    assert response_error(law, back) < 1e-6


def test_gains_and_silent_laws(rng):
    D = np.diag(rng.standard_normal(3))
    back = read_foton(foton_text(StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), D, rate_hz=100.0)))
    assert np.array_equal(back.frequency_response([1.0])[:, :, 0].real, D)
    late = StateSpace(
        np.eye(4, k=1), np.eye(4)[:, [3]], np.eye(4)[[0]], [[0.0]], rate_hz=100.0
    )  # four samples of delay
    f_hz = np.linspace(0.0, 50.0, 9)
    found = read_foton(foton_text(late)).frequency_response(f_hz)[0, 0]
    assert np.abs(found - np.exp(-2j * np.pi * 4 * f_hz / 100.0)).max() < 1e-12


def test_what_cannot_be_written_is_refused_and_leaves_nothing(law_of, rng, tmp_path):
    law, single = law_of(4), law_of(4, 1, 1)
    for what, name, settings, words in [
        (law, "law.xlsx", {}, "the suffix must be one of .mat, .h5, .csv, .txt"),
        (StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), "law.mat", {}, "in continuous time"),
        (StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), "law.txt", {}, "in continuous time"),
        (law, "law.mat", {"arrangement": "sum"}, "arrangement are for foton's '.txt'"),
        (single, "law.txt", {"arrangement": "wild"}, "'arrangement' must be one of 'cascade', 'sum'"),
        (single, "law.txt", {"name": "a b"}, "'name' must be letters"),
        (single, "law.txt", {"name": "a" * 60}, "at most 39 letters"),
        (modes(rng, 5.0, 300.0, 101, 0.3), "law.txt", {}, "a module holds 100 sections"),
        (modes(rng, 0.001, 0.002, 2, 0.001), "law.txt", {}, "changes by"),
    ]:
        with pytest.raises(InputError, match=re.escape(words)) as refused:
            export_law(what, tmp_path / name, **settings)
        print(refused.value)
    with pytest.raises(InputError, match="must be a StateSpace"):
        export_law("law", tmp_path / "law.mat")
    with pytest.raises(StorageError, match="could not be written"):
        export_law(law, tmp_path / "none" / "law.mat")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_law_is_said_to_be_none(rng, tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        read_law(tmp_path / "none.mat")
    for name, text in [
        ("a.mat", "hello"),
        ("b.csv", "what\nx,1"),
        ("c.txt", "MODULE 1 2\n"),
        ("d.txt", ""),
        ("e.csv", ""),
    ]:
        (tmp_path / name).write_text(text)
        with pytest.raises(StorageError):
            read_law(tmp_path / name)
    (tmp_path / "f.csv").write_text(export_law(modes(rng, 5, 9, 1, 0.1), tmp_path / "g.csv").read_text()[:-30])
    with pytest.raises(StorageError, match="holds no law"):
        read_law(tmp_path / "f.csv")
    scipy.io.savemat(tmp_path / "h.mat", {"x": 1.0})
    with pytest.raises(StorageError, match="holds no law"):
        read_law(tmp_path / "h.mat")
    from ultraquiet.files import save

    save(Record([[1.0]], [[1.0]], rate_hz=1.0), tmp_path / "i.h5")
    with pytest.raises(StorageError, match="holds a Record, not a law"):
        read_law(tmp_path / "i.h5")
    with pytest.raises(InputError, match="the suffix must be"):
        read_law(tmp_path / "j.xls")
