"""From a controller to a folder of whole-number C99, with its bounds, twin and self-test."""

import ctypes
import math
import tempfile
import time
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, between, one_of, positive, whole
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.deploy.c_code.output_folder import manifest_text, require_ours, write_folder
from ultraquiet.deploy.c_code.render import render
from ultraquiet.deploy.c_code.self_test import FNV_BASIS, FNV_PRIME, LCG_FACTOR, LCG_STEP, MASK
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole, fixed_law
from ultraquiet.deploy.fixed_point.twin import FixedTwin, words
from ultraquiet.deploy.law.form_choice import TOLERANCE, error_of
from ultraquiet.deploy.law.law import require_discrete, require_plant
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.deploy.toolchain.compiler import FLAGS, call, compile_c
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

STEPS = 20_000
# The level of a ramp counts in bits of the word; 2^18 steps, 75 s at 3.5 kHz, are as many as the self-test can climb.
RAMP_BITS = {"q15": 14, "q31": 18}
FILES = {
    "fixed.h.j2": "{name}.h",
    "fixed.c.j2": "{name}.c",
    "fixed_selftest.c.j2": "{name}_selftest.c",
    "fixed_host.c.j2": "{name}_host.c",
    "fixed_README.md.j2": "README.md",
}


@dataclass(frozen=True)
class FixedVerification:
    """Whether the compiled code gave the twin's words; `bit_exact` is None when nothing could be compared."""

    status: Status
    bit_exact: bool | None
    steps: int = 0
    self_test: bool | None = None
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """True when every word was the same and the self-test passed."""
        return self.status.ok


class FixedDeployment:
    """A generated folder of whole-number code; `tables` holds its figures, `status` a sentence on the law."""

    def __init__(self, law: FixedLaw, folder: Path, tables: dict[str, Any], status: Status) -> None:
        self.law, self.folder, self.tables, self.status = law, folder, tables, status

    @property
    def quantised(self) -> StateSpace:
        """The linear law with its rounded coefficients, volts to volts."""
        return self.law.state_space()

    @cached_property
    def controller(self) -> "FixedTwin | FixedCode":
        """The law in control, from rest: the compiled code, without a compiler its twin."""
        cc = compiler.compiler()
        return FixedTwin(self.law) if cc is None else FixedCode(self.law, self.folder, cc)

    def verify(self, steps: int = STEPS, seed: int = 0) -> FixedVerification:
        """Compile the code and compare `steps` samples over the whole range, and the self-test, with the twin."""
        whole("FixedDeployment.verify", "steps", steps, 1)
        whole("FixedDeployment.verify", "seed", seed, 0)
        cc = compiler.compiler()
        if cc is None:
            return FixedVerification(
                Status(StatusWord.NO_COMPILER, "No C compiler was found (cc, gcc, clang or $CC)."), None
            )
        began = time.perf_counter()
        try:
            code = FixedCode(self.law, self.folder, cc)
            passed = _self_test_passes(self.law, self.folder, cc)
        except ToolError as refusal:
            return FixedVerification(Status(StatusWord.NOT_COMPILED, str(refusal)), None)
        y = measurements(self.law, steps, seed)
        same = bool(np.array_equal(code.run(y), FixedTwin(self.law).run(y)))
        self.tables["bit_exact"] = same and passed
        word = StatusWord.DIFFERS if not same else StatusWord.OK if passed else StatusWord.SELF_TEST_FAILED
        said = {
            StatusWord.OK: f"All words of {steps} steps and of the self-test are the twin's, compiled by {cc}.",
            StatusWord.DIFFERS: f"Words of {steps} steps differ from the twin's.",
            StatusWord.SELF_TEST_FAILED: f"{steps} steps agree but the shipped self-test does not pass here.",
        }
        return FixedVerification(Status(word, said[word]), same and passed, steps, passed, time.perf_counter() - began)


class FixedCode:
    """The compiled whole-number code as a `Controller`, volts in and out through converters of its word."""

    def __init__(self, law: FixedLaw, folder: Path, cc: str) -> None:
        self.law = law
        with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
            made = Path(work) / f"{law.name}.so"
            sources = [folder / f"{law.name}.c", folder / f"{law.name}_host.c"]
            compile_c([cc, *FLAGS, "-fPIC", "-shared", *sources, "-o", made], folder)
            self._library = ctypes.CDLL(str(made))
        size = int(self._library[f"{law.name}_host_size"]())
        self._state = (ctypes.c_uint64 * (size // 8 + 1))()
        self._type = np.dtype(f"i{law.bits // 8}")
        self.reset()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    def reset(self) -> None:
        """Return to rest and take control at full command."""
        self._library[f"{self.law.name}_host_engage"](self._state)

    def run(self, y: ArrayLike) -> Whole:
        """Return the commands `(nu, n)` for measurements `(ny, n)`, both words."""
        given = np.ascontiguousarray(np.asarray(y).T, self._type)
        u = np.empty((len(given), self.law.outputs), self._type)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (given, u)]
        self._library[f"{self.law.name}_host_run"](self._state, *pointers, ctypes.c_uint32(len(given)))
        return u.T.astype(np.int64)

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        u = self.run(words(y, self.law.input_v, self.law.bits)[:, None])[:, 0]
        return u.astype(np.float64) * (self.law.output_v / 2.0 ** (self.law.bits - 1))


def generate_fixed(
    controller: StateSpace,
    folder: str | Path,
    word: str = "q31",
    name: str = "controller",
    *,
    form: str = "auto",
    scaling: str = "l1",
    input_v: float = 10.0,
    output_v: float = 25.0,
    ramp_s: float = 0.5,
    plant: StateSpace | None = None,
    tolerance: float = TOLERANCE,
) -> FixedDeployment:
    """Write a controller as C99 of whole numbers, with its self-test and the bounds it was scaled by.

    Args:
        controller: discrete, stable law from measurements to commands, u = K y.
        folder: where to write; appears whole or not at all, and replaces only what this package wrote.
        word: `q31` (32-bit words, 64-bit sums) or `q15` (16, 32).
        name: prefix of every file and symbol.
        form: `modal`, `delta`, or `auto`: the one that changes the loop less.
        scaling: `l1` (no overflow possible) or `l2` (finer states, limited in the code).
        input_v: full range of a measurement, volts.
        output_v: full range of a command, volts.
        ramp_s: about this many seconds from zero to full command: the nearest power of two of samples.
        plant: G of the loop u = K y, y = G u; judges the loop instead of the law's own response.
        tolerance: largest relative error of coefficients, and largest rounding noise as a share of the range.

    Raises:
        InputError: a law in continuous time, one that rounding makes unstable or that loses more than `tolerance`, bad
            settings.
        StorageError: the folder cannot be written or holds something else.

    >>> import tempfile
    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> generate_fixed(law, tempfile.mkdtemp() + "/code", "q15").status.word
    'ok'
    """
    folder = Path(folder).absolute()
    require_discrete(controller, name)
    require_plant(plant)
    one_of("generate_fixed", "word", word, tuple(RAMP_BITS))
    between("generate_fixed", "tolerance", tolerance, 0.0, 1.0)
    steps = positive("generate_fixed", "ramp_s", ramp_s, "s") * float(controller.rate_hz or 0)
    bits = round(math.log2(max(steps, 1.0)))
    if bits > RAMP_BITS[word]:
        longest = 2 ** RAMP_BITS[word] / float(controller.rate_hz or 0)
        raise InputError(f"generate_fixed: 'ramp_s' may be {longest:.3g} s in {word} at this rate, got {ramp_s:g} s.")
    require_ours(folder)
    settings: dict[str, Any] = {"scaling": scaling, "input_v": input_v, "output_v": output_v, "name": name}
    law, error = _best(controller, word, form, plant, settings | {"ramp_bits": bits})
    noise = float(law.noise_v.max()) / output_v
    what = "the response" if plant is None else "the loop's sensitivity"
    if not error <= tolerance or noise > tolerance:
        lost = "makes the loop unstable" if not np.isfinite(error) else f"changes {what} by {error:.1e} of its size"
        raise InputError(
            f"generate_fixed: {word} in {law.form} form {lost} and puts rounding noise of {noise:.1e} of the range on"
            f" the commands, more than {tolerance:g}; take {'q31' if word == 'q15' else 'float32'}, scaling='l2' or a"
            " larger tolerance."
        )
    reach = "no state can overflow" if not law.saturates else "states are limited"
    status = Status(
        StatusWord.OK,
        f"Rounding to {word} in {law.form} form changes {what} by {error:.1e} of its size and adds {noise:.1e} of the"
        f" range as noise; {reach}, the bound is {law.peak:.3f} of full scale.",
    )
    made = FixedDeployment(law, folder, _tables(law, error), status)
    write_folder(folder, _texts(made, controller.hash))
    return made


def _best(
    controller: StateSpace, word: str, form: str, plant: StateSpace | None, settings: dict[str, Any]
) -> tuple[FixedLaw, float]:
    tried: list[tuple[FixedLaw, float]] = []
    refusal = None
    for shape in ("modal", "delta") if form == "auto" else (form,):
        try:
            law = fixed_law(controller, word, shape, **settings)
            tried.append((law, error_of(law.state_space(), controller, plant)))
        except InputError as said:
            refusal = said  # the last form's: what it says to take has not been tried here
    if not tried:
        assert refusal is not None
        raise refusal
    return min(tried, key=lambda made: made[1])


def _tables(law: FixedLaw, error: float) -> dict[str, Any]:
    return {
        "states": law.order,
        "form": law.form,
        "precision": law.word,
        "scaling": law.scaling,
        "response_error": error,
        "state_bound": law.peak,
        "accumulator_bound": law.accumulator,
        "noise_v": float(law.noise_v.max()),
        "noise_bound_v": float(law.noise_bound_v.max()),
        "multiply_adds": law.multiply_adds,
        "coefficient_bytes": law.coefficient_bytes,
        "bit_exact": None,
    }


def measurements(law: FixedLaw, steps: int, seed: int) -> Whole:
    """Return words over the whole range: white noise, slow and fast square waves of full size, silence."""
    rng = np.random.default_rng(seed)
    top = 2 ** (law.bits - 1) - 1
    y = rng.integers(-top, top + 1, (law.inputs, steps))
    square = top * (1 - 2 * ((np.arange(steps) // rng.integers(1, 400, (law.inputs, 1))) % 2))
    kind = (np.arange(steps) // 500) % 3
    return np.where(kind == 0, y, np.where(kind == 1, square, y // 1024))


def _texts(made: FixedDeployment, model_hash: str) -> dict[str, str]:
    law = made.law
    context = {
        "law": law,
        "name": law.name,
        "NAME": law.name.upper(),
        "rate": f"{law.rate_hz:g}",
        "version": metadata.version("ultraquiet"),
        "model_hash": model_hash,
        "A": law.A.tolist(),
        "B": law.B.tolist(),
        "C": law.C.tolist(),
        "D": law.D.tolist(),
        "down_a": (law.shift_a + 2).tolist(),
        "down_b": (law.shift_b + 2).tolist(),
        "down_u": (law.shift_u + law.bits - 2).tolist(),
        "top": 2 ** (law.bits - 1) - 1,
        "rows": self_test(law),
        "basis": FNV_BASIS,
        "prime": FNV_PRIME,
        "factor": LCG_FACTOR,
        "step": LCG_STEP,
        "tables": {key.replace("_", " "): value for key, value in made.tables.items() if value is not None},
        "status": made.status,
        "flags": " ".join(FLAGS),
    }
    files = {file.format(name=law.name): render(template, context) for template, file in FILES.items()}
    held = {"name": law.name, "model_sha256": model_hash, "coefficients_sha256": law.hash, "tables": made.tables}
    return files | {"manifest.json": manifest_text(held | {"status": str(made.status)})}


def self_test(law: FixedLaw) -> list[dict[str, Any]]:
    """Return the self-test's calls with the digests the twin leaves."""
    full = 2**law.ramp_bits
    part = max(min(full // 2, 40), 1)
    plan = [("RUN", 3), ("ENABLE", 0), ("RUN", part), ("DISABLE", 0), ("RUN", max(part // 2, 1)), ("ENABLE", 0)]
    plan += [("RUN", full + 100), ("HIGH", 60), ("LOW", 60), ("RUN", 40), ("DISABLE", 0), ("RUN", full + 2)]
    plan += [("ENABLE", 0), ("RUN", 20)]
    if law.saturates:  # states at their ranges' corners, which a turn of the block carries beyond
        plan += [("PUSH", 0), ("RUN", 1), ("PUSH", 1), ("RUN", 1)]
    twin, drawn, digest, rows = FixedTwin(law), 1, FNV_BASIS, []
    twin.init()
    top = 2 ** (law.bits - 1) - 1
    for op, count in plan:
        if op in ("ENABLE", "DISABLE"):
            getattr(twin, op.lower())()
        if op == "PUSH":
            twin.x = np.where(np.arange(law.states) * count % 2 == 0, top, -top)
        folded: list[int] = []
        for _ in range(count if op in ("RUN", "HIGH", "LOW") else 0):
            y = np.zeros(law.inputs, np.int64)
            for j in range(law.inputs):
                drawn = (drawn * LCG_FACTOR + LCG_STEP) & MASK
                y[j] = ((drawn >> 8) - 8388607) * 256 if law.bits == 32 else (drawn >> 16) - 32768
            folded += twin.output(y if op == "RUN" else np.full_like(y, top if op == "HIGH" else -top)).tolist()
            twin.update()
        folded += [*twin.x.tolist(), twin.level, twin.clipped, twin.limited]
        for value in folded:
            digest = ((digest ^ (value & MASK)) * FNV_PRIME) & MASK
        rows.append({"op": op, "count": count, "digest": digest})
    return rows


def _self_test_passes(law: FixedLaw, folder: Path, cc: str) -> bool:
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        program = Path(work) / "selftest"
        sources = [folder / f"{law.name}.c", folder / f"{law.name}_selftest.c"]
        compile_c([cc, *FLAGS, f"-D{law.name.upper()}_MAIN", *sources, "-o", program], folder)
        return call([program], Path(work)).returncode == 0
