"""Banks that come and go in every step, while limits are met, measurements are NaN and frames are late.

Whatever is loaded, the compiled code does what its twin does, bit by bit, and no command leaves its limits.
"""

import ctypes

import numpy as np
import pytest
from compilers_here import compiler
from deploy_laws import RATE_HZ, random_law
from test_deploy_coverage import banked

from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.deploy import Twin, generate
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.law.coefficients import bank_from, bank_of, numbers
from ultraquiet.deploy.toolchain.compiler import CONTRACT_OFF
from ultraquiet.deploy.verification.fuzz import fuzz_code

LIMIT_V = 3.0
ASKED = ("load_bank", "swap", "enable", "clear", "excite", "frame")
TOLD = ("attach", "disable", "init", "output", "update")
LAWS = {
    "modal": (lambda rng: random_law(rng, 7, 3, 2), {"form": "modal", "anti_windup": True}),
    "delta": (lambda rng: random_law(rng, 6, 1, 4), {"form": "delta"}),
    "bank": (lambda rng: banked(rng, (2, 0, 1)), {"form": "bank", "anti_windup": True}),
    "schur": (lambda rng: random_law(rng, 7, 2, 2), {"form": "schur", "anti_windup": True, "precision": "float64"}),
    "dense": (lambda rng: random_law(rng, 5, 3, 3), {"form": "dense"}),
}


class Both:
    """The compiled code and its twin, asked the same."""

    def __init__(self, made, library):
        self.law, self.twin = made.law, Twin(made.law)
        self._state = CompiledController(library)._state
        self._calls = {name: library.function(name) for name in (*ASKED, *TOLD)}
        for name in ASKED:
            self._calls[name].restype = ctypes.c_bool
        self._pair = (ctypes.c_double * (2 * numbers(made.law).size + 2))()
        self._calls["init"](self._state, None)
        self._calls["attach"](self._state, self._pair)
        self.twin.attach()

    def call(self, name):
        code, twin = self._calls[name](self._state), getattr(self.twin, name)()
        assert name in TOLD or code == twin

    def swap(self, keep):
        code = self._calls["swap"](self._state, ctypes.c_bool(keep))
        assert code == self.twin.swap(keep)
        return code

    def load(self, words, crc):
        words = np.ascontiguousarray(words)
        code = self._calls["load_bank"](self._state, ctypes.c_void_p(words.ctypes.data), ctypes.c_uint32(crc))
        assert code == self.twin.load_bank(words, crc)
        return code

    def excite(self, volts):
        assert self._calls["excite"](self._state, ctypes.c_void_p(volts.ctypes.data)) == self.twin.excite(volts)

    def output(self, y):
        u = np.empty(self.law.outputs, self.law.dtype)
        self._calls["output"](self._state, *(ctypes.c_void_p(each.ctypes.data) for each in (y, u)))
        assert u.tobytes() == np.asarray(self.twin.output(y), self.law.dtype).tobytes()
        assert np.all((self.law.limits[:, 0] <= u) & (u <= self.law.limits[:, 1]))
        return u


def drawn_bank(rng, law):
    """A share of the law's own numbers, or of any size, or the largest, or denormal; some not finite or mis-summed."""
    own, kind = numbers(law), rng.integers(8)
    row = own * law.dtype(rng.uniform(-2, 2))
    if kind > 4:
        row = (rng.standard_normal(own.size) * 10.0 ** rng.uniform(-30, 30)).astype(law.dtype)
    if kind == 0:
        row[rng.integers(row.size)] = rng.choice([np.nan, np.inf, -np.inf])
    if kind in (1, 2):
        row[:] = np.finfo(law.dtype).max if kind == 1 else np.finfo(law.dtype).smallest_subnormal
    bank = bank_from(row)
    return bank.words, bank.crc ^ int(kind == 3)


def siege(made, library, rng, steps):
    """Drive both through random calls and return how many banks were taken and swapped, and steps that met a limit."""
    both, law, done = Both(made, library), made.law, np.zeros(3, int)
    for _ in range(steps):
        if rng.integers(3):
            done[0] += both.load(*drawn_bank(rng, law))
        if rng.integers(2):
            done[1] += both.swap(bool(rng.integers(2)))
        call = rng.integers(16)
        if call < 9:
            both.call("enable" if call < 4 else "disable" if call == 4 else "clear")
        elif call == 9:
            volts = (rng.standard_normal(law.outputs) * 10.0 ** rng.integers(-3, 38)).astype(law.dtype)
            volts[0] *= law.dtype(rng.choice([1.0, np.nan]))
            both.excite(volts)
        both.call("frame")
        y = (rng.standard_normal(law.inputs) * 10.0 ** rng.uniform(-3, 6)).astype(law.dtype)
        if not rng.integers(30):
            y[rng.integers(y.size)] = rng.choice([np.nan, np.inf, -np.inf, np.finfo(law.dtype).max])
        done[2] += np.any(np.abs(both.output(y)) == LIMIT_V)
        if rng.integers(20):
            both.call("update")
    return done


def generated(rng, name, tmp_path):
    make, how = LAWS[name]
    return generate(make(rng), tmp_path / "code", limits_v=LIMIT_V, ramp_s=5 / RATE_HZ, **how)


@pytest.mark.gate("schur")
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning", "ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("name", ["modal", "schur"])
def test_switching_in_every_step_leaves_bits_and_limits(name, rng, tmp_path, cc):
    made = generated(rng, name, tmp_path)
    taken, swapped, limited = siege(
        made, Library(made.law, made.folder, cc, ("-std=c99", "-O1", *CONTRACT_OFF)), rng, 600
    )
    assert taken > 50
    assert swapped > 30
    assert limited > 0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning", "ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("name", LAWS)
def test_every_build_switches_alike_or_is_refused(name, rng, tmp_path):
    made = generated(rng, name, tmp_path)
    seed = int(rng.integers(2**32))
    for tool in filter(None, map(compiler, ("gcc", "clang"))):
        done = set()
        for level in ("-O0", "-O1", "-O2", "-O3", "-Os"):
            library = Library(made.law, made.folder, tool, ("-std=c99", level, *CONTRACT_OFF))
            done.add(tuple(siege(made, library, np.random.default_rng(seed), 3000)))
        assert len(done) == 1
        print(f"{name}, {tool}: {done.pop()} banks taken, swapped, steps that met a limit")
        for flags in (("-Ofast",), ("-O2", "-ffast-math"), ("-O2", "-ffinite-math-only")):
            with pytest.raises(ToolError, match="removes the NaN guard"):
                Library(made.law, made.folder, tool, ("-std=c99", "-w", *flags))


def test_a_bank_of_another_length_or_kind_is_refused(rng, tmp_path):
    made = generate(random_law(rng, 4, 2, 2), tmp_path / "code", limits_v=LIMIT_V)
    bank, twin = bank_of(made.law), Twin(made.law)
    twin.attach()
    for wrong in (
        bank.words[:-1],
        np.append(bank.words, 0),
        bank.words[:0],
        bank.words.astype("<u8").view("<u4"),
        bank.words[None],
        bank.words.astype(float),
        bank.words.astype(np.int64) - 2**32,
    ):
        with pytest.raises(InputError, match=r"a bank of this code is 28 whole numbers of 32 bits, got"):
            twin.load_bank(wrong, bank.crc)
        assert not twin.swap(keep=True)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_shipped_fuzz_switches_banks_too(precision, rng, tmp_path, cc):
    made = generate(random_law(rng, 6, 2, 2), tmp_path / "code", precision, limits_v=LIMIT_V, anti_windup=True)
    try:
        assert fuzz_code(made, cc, 200_000).finding == ""
    except ToolError as missing:
        pytest.skip(str(missing))
