"""What may be done to code that runs: excitation, taps, another coefficient bank, overruns; and when to stop it.

The twin stands for the code here: the self-test of every folder compares the two bit by bit through all of this.
"""

import ctypes
import subprocess
import zlib

import numpy as np
import pytest
from deploy_laws import RATE_HZ

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import Twin, generate
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.law.coefficients import bank_of, numbers, with_numbers
from ultraquiet.deploy.law.twin import FAULT, FAULT_OVERRUN, OFF, ON, STOPPING
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.values import StateSpace


def running(law, **settings):
    twin = Twin(law)
    twin.reset()
    return twin


def small(rng, law, steps=200, volts=5.0):
    """Measurements whose linear commands peak at `volts`."""
    y = rng.standard_normal((law.D.shape[1], steps))
    return (y * volts / np.abs(law.simulate(y)).max()).T


def gains(law, factor):
    return StateSpace(law.A, law.B, factor * law.C, factor * law.D, rate_hz=law.rate_hz)


def test_excitation_reaches_the_command_within_its_own_limit(law_of, rng, tmp_path):
    law = law_of(10)
    made = generate(law, tmp_path / "code", limits_v=10.0, excitation_v=2.0)
    alone, excited = running(made.law), running(made.law)
    y = small(rng, law)
    added = rng.uniform(-3.0, 3.0, (200, 6))
    difference = []
    for k in range(200):
        assert excited.excite(added[k])
        difference.append(excited.step(y[k]) - alone.step(y[k]))
    largest = np.abs(np.array(difference)).max()
    print(f"excitation asked for up to {np.abs(added).max():.2f} V, found in the command up to {largest:.2f} V")
    assert np.allclose(difference, np.clip(added, -2.0, 2.0), atol=1e-4)
    assert not excited.excite([0, 0, np.nan, 0, 0, 0])
    assert np.allclose(excited.step(y[0]), alone.step(y[0]), atol=1e-4)
    default = generate(law, tmp_path / "code", limits_v=[[-10.0, 20.0]] * 6).law.excitation
    assert np.allclose(default, [[-1.0, 2.0]] * 6)


def test_command_stays_within_the_actuators_limits_whatever_is_added(law_of, rng, tmp_path):
    made = generate(law_of(10), tmp_path / "code", limits_v=3.0, excitation_v=3.0)
    twin = running(made.law)
    for _ in range(200):
        twin.excite(rng.uniform(-9.0, 9.0, 6))
        assert np.abs(twin.step(rng.standard_normal(6) * 9)).max() <= 3.0


def test_state_hears_of_what_the_limits_took_from_the_excitation_too(tmp_path):
    pole = np.exp(-2 * np.pi * 0.2 / RATE_HZ)
    law = StateSpace([[pole]], [[0.02]], [[1.0]], [[0.05]], rate_hz=RATE_HZ)
    made = generate(law, tmp_path / "code", "float64", limits_v=5.0, excitation_v=5.0, anti_windup=True)
    twin = running(made.law)
    twin.excite([4.0])
    for _ in range(3500):
        twin.step([50.0])
    assert twin.applied[0] == 5.0
    assert twin.raw[0] + 4.0 == pytest.approx(5.0, rel=0.6)  # held near the limit, not wound up to hundreds of volts


def test_a_bank_with_the_state_kept_takes_effect_between_two_steps(law_of, rng, tmp_path):
    law = law_of(12)
    made = generate(law, tmp_path / "code", form="modal")
    bank = made.bank(gains(law, 0.5))
    twin, other = running(made.law), running(made.law)
    twin.attach()
    y = small(rng, law)
    for k in range(100):
        assert np.array_equal(twin.step(y[k]), other.step(y[k]))
    assert twin.load_bank(bank.words, bank.crc)
    assert np.array_equal(twin.step(y[100]), other.step(y[100]))
    assert twin.swap(keep=True)
    assert np.array_equal(twin.output(y[101].astype(np.float32)), other.output(y[101].astype(np.float32)))
    twin.update()
    other.update()
    after = twin.step(y[102])
    exact = gains(law, 0.5).simulate(y[:103].T)[:, 102]
    print(f"command after the swap: {np.abs(after).max():.3f} V; halved law alone {np.abs(exact).max():.3f} V")
    assert twin.bank == 1
    assert np.abs(after).max() <= 5.01


@pytest.mark.gate("crc", "nan")
@pytest.mark.parametrize("spoilt", ["crc", "bit", "nan", "infinite"])
def test_an_unsound_bank_is_refused_and_the_running_one_untouched(law_of, rng, tmp_path, spoilt):
    law = law_of(8)
    made = generate(law, tmp_path / "code")
    bank = bank_of(with_numbers(made.law, numbers(made.law) * np.float32(0.5)))
    words, crc = bank.words.copy(), bank.crc
    at = int(rng.integers(words.size))
    if spoilt == "crc":
        crc ^= 1 << int(rng.integers(32))
    elif spoilt == "bit":
        words[at] ^= 1 << int(rng.integers(32))
    else:
        words[at] = 0x7FC00000 if spoilt == "nan" else 0xFF800000
        crc = zlib.crc32(words.astype("<u4").tobytes())
    twin, other = running(made.law), running(made.law)
    twin.attach()
    assert not twin.load_bank(words, crc)
    assert not twin.swap(keep=True)
    for y in small(rng, law, 50):
        assert np.array_equal(twin.step(y), other.step(y))


def test_a_bank_by_ramp_never_jumps(law_of, rng, tmp_path):
    law = law_of(12)
    made = generate(law, tmp_path / "code", ramp_s=0.05, form="modal")
    bank = made.bank(law_of(12))
    twin = running(made.law)
    twin.attach()
    y = small(rng, law, 600)
    assert twin.load_bank(bank.words, bank.crc)
    assert twin.swap(keep=False)
    modes, shares = [], []
    for sample in y:
        twin.step(sample)
        modes.append(twin.mode)
        shares.append(twin.level / made.law.ramp_steps)
    steps = np.abs(np.diff(shares))
    print(f"the share of the command moves by at most {steps.max():.4f} a step and returns to {shares[-1]}")
    assert steps.max() <= 1.001 / made.law.ramp_steps
    assert min(shares) == 0.0
    assert modes[-1] == ON
    assert twin.bank == 1


def test_a_bank_that_does_not_fit_is_a_sentence(law_of, tmp_path):
    made = generate(law_of(8), tmp_path / "code", form="modal")
    with pytest.raises(InputError, match=r"code for 8 states.*cannot take the coefficients of 10 states"):
        made.bank(law_of(10))
    slow = law_of(8)
    with pytest.raises(InputError, match="the code runs at 3500 Hz, the controller at 100"):
        made.bank(StateSpace(slow.A, slow.B, slow.C, slow.D, rate_hz=100.0))


@pytest.mark.gate("modal-float32", "schur-float64")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("form", ["modal", "delta", "schur", "dense"])
def test_compiled_code_takes_the_bank_that_python_made(law_of, rng, tmp_path, cc, form, precision):
    law = law_of(10)
    made = generate(law, tmp_path / "code", precision, form=form, anti_windup=True)
    bank = bank_of(with_numbers(made.law, numbers(made.law) * made.law.dtype(0.75)))
    library = Library(made.law, made.folder, cc)
    code, twin = CompiledController(library), running(made.law)
    memory = (ctypes.c_double * (2 * bank.words.size + 2))()
    words = np.ascontiguousarray(bank.words)
    library.function("load_bank").restype = library.function("swap").restype = ctypes.c_bool
    library.function("attach")(code._state, memory)
    twin.attach()
    y = small(rng, law)
    for k, sample in enumerate(y):
        if k == 50:
            load, swap = library.function("load_bank"), library.function("swap")
            load.restype = swap.restype = ctypes.c_bool
            at = ctypes.c_void_p(words.ctypes.data)
            assert not load(code._state, at, ctypes.c_uint32(bank.crc ^ 1))
            assert load(code._state, at, ctypes.c_uint32(bank.crc))
            assert swap(code._state, ctypes.c_bool(True))
            assert twin.load_bank(bank.words, bank.crc)
            assert twin.swap(keep=True)
        assert np.array_equal(code.step(sample), twin.step(sample)), k
    assert twin.bank == 1


def test_overruns_in_a_row_ramp_out_and_the_law_comes_back(law_of, rng, tmp_path):
    law = law_of(10)
    made = generate(law, tmp_path / "code", ramp_s=0.01, overrun_limit=3)
    twin = running(made.law)
    y = small(rng, law, 300).astype(np.float32)
    for k in range(20):
        assert twin.frame()
        twin.step(y[k])
    twin.output(y[20])
    assert [twin.frame() for _ in range(3)] == [False] * 3
    twin.update()
    assert twin.mode == ON  # seen at the next step
    twin.step(y[21])
    assert (twin.mode, twin.faults, twin.overruns) == (FAULT, FAULT_OVERRUN, 3)
    for k in range(22, 22 + made.law.ramp_steps):
        u = twin.step(y[k])
    assert np.all(u == 0)
    assert not twin.enable()
    assert twin.clear()
    assert twin.mode == OFF
    assert twin.enable()
    for k in range(100, 100 + made.law.ramp_steps):
        twin.step(y[k])
    assert twin.level == made.law.ramp_steps
    print(f"3 overruns: out in {made.law.ramp_steps} steps, back in as many")


def test_fewer_overruns_and_one_frame_in_three_are_borne_every_other_is_not(law_of, tmp_path):
    made = generate(law_of(4), tmp_path / "code", overrun_limit=4)

    def latches(pattern, repeats=100):
        twin = running(made.law)
        for late in pattern * repeats:
            if late:
                twin.busy = True
                twin.frame()
            else:
                twin.busy = False
                twin.frame()
                twin.step(np.zeros(6))
        return twin.faults == FAULT_OVERRUN

    assert not latches([1, 1, 1] + 8 * [0])
    assert latches([1, 1, 1, 1] + 8 * [0])
    assert not latches([1, 0, 0])
    assert latches([1, 0])


def test_disable_during_a_swap_stays_out(law_of, rng, tmp_path):
    law = law_of(6)
    made = generate(law, tmp_path / "code", ramp_s=0.01)
    bank = bank_of(made.law)
    twin = running(made.law)
    twin.attach()
    twin.load_bank(bank.words, bank.crc)
    twin.swap(keep=False)
    y = small(rng, law, 100)
    twin.step(y[0])
    assert twin.mode == STOPPING
    twin.disable()
    for sample in y[1:]:
        twin.step(sample)
    assert twin.mode == OFF
    assert twin.bank == 1


def test_taps_show_the_chosen_signals(law_of, rng, tmp_path):
    made = generate(law_of(6), tmp_path / "code")
    twin = running(made.law)
    twin.excite([0.5] * 6)
    assert all(twin.select(k, signal, k) for k, signal in enumerate((1, 2, 3, 6)))
    assert not twin.select(4, 1, 0)
    assert not twin.select(0, 1, 6)
    y = rng.standard_normal(6)
    u = twin.step(y)
    shown = twin.monitor()
    assert shown[0] == np.float32(y[0])
    assert shown[1] == twin.x[1]
    assert shown[2] == twin.raw[2]
    assert shown[3] == np.float32(u[3])


@pytest.mark.slow
def test_self_test_holds_over_many_laws(law_of, rng, tmp_path, cc):
    rows = 0
    for k in range(6):
        law = law_of(int(rng.integers(0, 14)), int(rng.integers(1, 7)), int(rng.integers(1, 7)))
        form, aware = ("modal", "delta", "schur")[k % 3], bool(rng.integers(2))
        settings = {"ramp_s": float(rng.uniform(0.0003, 0.01)), "overrun_limit": int(rng.integers(1, 6))}
        generate(law, tmp_path / "code", form=form, anti_windup=aware, **settings)
        sources = ["controller.c", "controller_selftest.c"]
        command = [cc, *FLAGS, "-DCONTROLLER_MAIN", *sources, "-o", "selftest"]
        subprocess.run(command, cwd=tmp_path / "code", check=True)
        told = subprocess.run([tmp_path / "code" / "selftest"], capture_output=True, text=True, check=False)
        assert told.returncode == 0, (told.stdout, form, aware, settings, law.D.shape)
        rows += int(told.stdout.split(",")[1].split()[0])
    print(f"{rows} rows of 6 self-tests, bit for bit")
