"""Proof that the code does what the law says: compiled here, run here, compared bit by bit."""

import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.compiled import CompiledController, Library
from ultraquiet.deploy.cortex import Count, count_instructions, missing_tool
from ultraquiet.deploy.emit import FLAGS
from ultraquiet.deploy.law import Law, Rounded
from ultraquiet.deploy.script import sizes
from ultraquiet.deploy.toolchain import call, compile_c
from ultraquiet.deploy.twin import Twin
from ultraquiet.values.status import Status

STEPS = 100_000


@dataclass(frozen=True)
class Verification:
    """What the proof found.

    `bit_exact` is None when nothing could be compared, `mismatches` counts commands that differ in at least one bit,
    `first` is the (step, output) of the first one, `self_test` whether the shipped self-test passed on this machine,
    `cortex_m7` what the emulated target said (None without its tools).
    """

    status: Status
    bit_exact: bool | None
    steps: int = 0
    mismatches: int = 0
    first: tuple[int, int] | None = None
    self_test: bool | None = None
    compiler: str | None = None
    seconds: float = 0.0
    cortex_m7: Count | None = None

    @property
    def ok(self) -> bool:
        """True when every bit was the same and the self-test passed."""
        return self.status.ok


def verify_code(law: Law, folder: Path, cc: str | None, steps: int = STEPS, seed: int = 0) -> Verification:
    """Compile the folder's code, run `steps` samples through it and through the twin, and compare the bits.

    The measurements are noise whose size changes so that quiet, limited and bad samples all occur; `seed` draws them.
    """
    if cc is None:
        return Verification(Status("no compiler", _NO_COMPILER), None)
    began = time.perf_counter()
    try:
        library = Library(law, folder, cc)
        self_test = _self_test(law, folder, cc)
    except ToolError as refusal:
        return Verification(Status("not compiled", str(refusal)), None, compiler=cc)
    target, complaint = _on_target(law, folder)
    y = measurements(law, steps, seed)
    code, twin = CompiledController(library, ramp=True), Twin(law)
    twin.enable()
    mismatches, first = compare(code.run(y), twin.run(y))
    found = Verification(
        Status("ok", ""),
        mismatches == 0 and self_test and (target is None or target.self_test),
        steps,
        mismatches,
        first,
        self_test,
        cc,
        time.perf_counter() - began,
        target,
    )
    return replace(found, status=_verdict(found, complaint))


def measurements(law: Law, steps: int, seed: int) -> Rounded:
    """Return noise `(ny, steps)`: nine tenths inside the limits with bursts beyond them, NaN near the end."""
    rng = np.random.default_rng(seed)
    quiet, loud = (scale * 2.0**23 for scale in sizes(law))
    y = rng.standard_normal((law.inputs, steps)) * quiet
    burst = (np.arange(steps) // 250) % 10 == 9
    y[:, burst] *= loud / quiet
    y[rng.integers(law.inputs), steps - min(steps, 50)] = np.nan
    with np.errstate(over="ignore"):
        return y.astype(law.dtype)


def compare(one: Rounded, other: Rounded) -> tuple[int, tuple[int, int] | None]:
    """Return how many commands differ in at least one bit, and the (step, output) of the first."""
    word = f"u{one.dtype.itemsize}"
    differs = np.ascontiguousarray(one.T).view(word) != np.ascontiguousarray(other.T).view(word)
    if not differs.any():
        return 0, None
    step, output = np.argwhere(differs)[0]
    return int(np.count_nonzero(differs)), (int(step), int(output))


def _self_test(law: Law, folder: Path, cc: str) -> bool:
    """Compile and run the shipped self-test in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        for source in folder.glob(f"{law.name}*.[ch]"):
            shutil.copy(source, work)
        program = Path(work) / "selftest"
        names = [f"{law.name}.c", f"{law.name}_selftest.c"]
        compile_c([cc, *FLAGS, f"-D{law.name.upper()}_MAIN", *names, "-o", program], Path(work))
        return call([program], Path(work)).returncode == 0


def _on_target(law: Law, folder: Path) -> tuple[Count | None, str]:
    """Return the count, or None with what the target's tools complained about; they are no part of the comparison."""
    if missing_tool() is not None:
        return None, ""
    try:
        return count_instructions(law, folder), ""
    except ToolError as refusal:
        return None, f" {refusal}"


def _verdict(found: Verification, complaint: str) -> Status:
    if found.first is not None:
        step, output = found.first
        sentence = f"{found.mismatches} commands of {found.steps} steps differ from the twin, the first at step {step}"
        return Status("differs", f"{sentence}, output {output}.")
    if not found.self_test:
        return Status("self-test failed", f"{found.steps} steps agree but the shipped self-test does not pass here.")
    if found.cortex_m7 is not None and not found.cortex_m7.self_test:
        return Status("self-test failed", "The code agrees here but its self-test does not pass on the Cortex-M7.")
    where = "" if found.cortex_m7 is None else ", and the self-test's on an emulated Cortex-M7"
    sentence = f"All bits of {found.steps} steps and of the self-test are the twin's, compiled by {found.compiler}"
    return Status("ok", f"{sentence}{where}.{complaint}")


_NO_COMPILER = (
    "No C compiler was found (cc, gcc, clang or $CC), so nothing was compared; install one and verify again, or run"
    " 'make check' in the folder elsewhere."
)
