"""Proof that the code does what the law says: compiled here and for the targets, run, compared bit by bit."""

import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.c_code.plan import CodePlan, GeneratedCode
from ultraquiet.deploy.c_code.self_test import HALF_RANGE
from ultraquiet.deploy.law.law import Law, Rounded
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain.compiler import FLAGS, call, compile_c
from ultraquiet.deploy.toolchain.targets import target_named
from ultraquiet.deploy.verification.bench_tones import OnBench
from ultraquiet.deploy.verification.emulated_target import OnTarget, differing, try_on_target
from ultraquiet.deploy.verification.fuzz import STEPS as FUZZ_STEPS
from ultraquiet.deploy.verification.fuzz import Fuzz, fuzz_code
from ultraquiet.deploy.verification.rounded_loop import Reanalysis
from ultraquiet.values.status import Status, StatusWord

STEPS, MOST_STEPS = 100_000, 10_000_000  # half a gigabyte of measurements six channels wide

compare = differing


@dataclass(frozen=True)
class Verification(Shown):
    """What the proof found.

    `bit_exact` is None when nothing could be compared, `mismatches` counts commands that differ in at least one bit,
    `first` is the (step, output) of the first one, `self_test` whether the shipped self-test passed on this machine.
    `targets` is what the emulated processors said, `missing` says what did not run and why. `loop` is the loop with the
    rounded law analysed again, `bench` the code on a bench, each None unless a plant or a bench was given; `fuzz` is
    what random bits found under the sanitizers, None without them.
    """

    status: Status
    bit_exact: bool | None
    steps: int = 0
    mismatches: int = 0
    first: tuple[int, int] | None = None
    self_test: bool | None = None
    compiler: str | None = None
    seconds: float = 0.0
    targets: tuple[OnTarget, ...] = ()
    missing: tuple[str, ...] = ()
    fuzz: Fuzz | None = None
    loop: Reanalysis | None = None
    bench: OnBench | None = None

    @property
    def ok(self) -> bool:
        """True when every bit was the same, the self-tests passed, and neither loop nor bench lost half a decibel."""
        return self.status.ok

    @property
    def cortex_m7(self) -> OnTarget | None:
        """What the emulated Cortex-M7 said."""
        return self.on("cortex-m7")

    def on(self, target: str) -> OnTarget | None:
        """Return what a target said, None when it did not run."""
        return next((each for each in self.targets if each.target.name == target), None)

    def figures(self) -> dict[str, Any]:
        """Return what was found for the deployment's tables."""
        figures: dict[str, Any] = {"bit_exact": self.bit_exact}
        for each in self.targets:
            figures[f"{each.target.key}_instructions"] = each.step
            figures[f"{each.target.key}_output_instructions"] = each.output
        if self.targets:
            figures["bit_exact_on"] = {each.target.name: each.bit_exact for each in self.targets}
            figures["latency_us"] = {each.target.name: each.latency_us for each in self.targets}
        if self.bench is not None:
            figures["bench_loss_db"] = float(self.bench.loss_db.max())
        return figures

    def with_loop(self, loop: Reanalysis | None, bench: OnBench | None) -> "Verification":
        """Return the proof with what became of the loop."""
        status = self.status
        for proof in (loop, bench):
            if proof is None:
                continue
            # A loop that the design itself cannot hold says nothing against the code.
            fault = proof.status.word in (StatusWord.UNSTABLE, StatusWord.DEGRADED) and (
                bench is proof or _designed_stable(loop)
            )
            word = proof.status.word if status.ok and fault else status.word
            status = Status(word, f"{status.sentence} {proof.status.sentence}")
        return replace(self, loop=loop, bench=bench, status=status)


def verify_code(
    generated: GeneratedCode,
    cc: str | None,
    steps: int = STEPS,
    seed: int = 0,
    targets: Sequence[str] = (),
    fuzz_steps: int = FUZZ_STEPS,
) -> Verification:
    """Compile the folder's code, run `steps` samples through it and through the twin, and compare the bits.

    The measurements are noise whose size changes so that quiet, limited and bad samples all occur; `seed` draws them.
    The targets get the same measurements (at most 100 000 of them) where compiler and emulator are at hand; then
    `fuzz_steps` random steps run under the sanitizers.
    """
    for name in targets:
        target_named(name)
    if cc is None:
        return Verification(Status(StatusWord.NO_COMPILER, _NO_COMPILER), None, missing=(_NO_COMPILER,))
    law, folder, began = generated.law, generated.folder, time.perf_counter()
    try:
        library = Library(law, folder, cc)
        self_test = _self_test(law, folder, cc)
    except ToolError as refusal:
        return Verification(Status(StatusWord.NOT_COMPILED, str(refusal)), None, compiler=cc)
    y = measurements(generated.plan, steps, seed)
    code, twin = CompiledController(library, ramp=True), Twin(law)
    twin.enable()
    expected = twin.run(y)
    mismatches, first = differing(code.run(y), expected)
    ran, missing = _on_targets(law, folder, y, expected, targets)
    fuzz = None
    try:
        fuzz = fuzz_code(generated, cc, fuzz_steps, seed) if fuzz_steps else None
    except ToolError as refusal:
        missing.append(str(refusal))
    exact = mismatches == 0 and self_test and all(each.bit_exact for each in ran)
    pending, seconds = Status(StatusWord.OK, ""), time.perf_counter() - began
    proof = Verification(
        pending, exact, steps, mismatches, first, self_test, cc, seconds, ran, tuple(dict.fromkeys(missing)), fuzz
    )
    return replace(proof, status=_verdict(proof))


def _on_targets(
    law: Law, folder: Path, y: Rounded, expected: Rounded, targets: Sequence[str]
) -> tuple[tuple[OnTarget, ...], list[str]]:
    """Return what each target said, and why others said nothing."""
    ran: list[OnTarget] = []
    missing: list[str] = []
    without: dict[str, list[str]] = {}
    for target in map(target_named, targets):
        if (absent := target.family.missing_program()) is not None:
            without.setdefault(absent, []).append(target.title)
            continue
        try:
            ran.append(try_on_target(law, folder, y, expected, target))
        except ToolError as refusal:
            # An emulator that does not work is no finding about the code.
            missing.append(str(refusal))
    for program, titles in without.items():
        missing.append(f"'{program}' is not installed, so nothing was run or counted on {' and '.join(titles)}.")
    return tuple(ran), missing


def measurements(plan: CodePlan, steps: int, seed: int) -> Rounded:
    """Return noise `(ny, steps)`: nine tenths inside the limits with bursts beyond them, NaN near the end."""
    rng = np.random.default_rng(seed)
    law, quiet, loud = plan.law, plan.quiet * HALF_RANGE, plan.loud * HALF_RANGE
    y = rng.standard_normal((law.inputs, steps)) * quiet
    burst = (np.arange(steps) // 250) % 10 == 9
    y[:, burst] *= loud / quiet
    y[rng.integers(law.inputs), steps - min(steps, 50)] = np.nan
    with np.errstate(over="ignore"):
        return y.astype(law.dtype)


def _self_test(law: Law, folder: Path, cc: str) -> bool:
    """Compile and run the shipped self-test in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        for source in folder.glob(f"{law.name}*.[ch]"):
            shutil.copy(source, work)
        program = Path(work) / "selftest"
        names = [f"{law.name}.c", f"{law.name}_selftest.c"]
        compile_c([cc, *FLAGS, f"-D{law.name.upper()}_MAIN", *names, "-o", program], Path(work))
        return call([program], Path(work)).returncode == 0


def _designed_stable(loop: Reanalysis | None) -> bool:
    return loop is not None and loop.designed.stable


def _verdict(proof: Verification) -> Status:
    if proof.first is not None:
        step, output = proof.first
        sentence = f"{proof.mismatches} commands of {proof.steps} steps differ from the twin, the first at step {step}"
        return Status(StatusWord.DIFFERS, f"{sentence}, output {output}.")
    if not proof.self_test:
        return Status(
            StatusWord.SELF_TEST_FAILED, f"{proof.steps} steps agree but the shipped self-test does not pass here."
        )
    for each in proof.targets:
        title = each.target.title
        if each.mismatches:
            sentence = (
                f"The code agrees here, but {each.mismatches} commands of {each.steps} steps differ on the {title}."
            )
            return Status(StatusWord.DIFFERS, sentence)
        if not each.self_test:
            return Status(
                StatusWord.SELF_TEST_FAILED, f"The code agrees here but its self-test does not pass on the {title}."
            )
    if proof.fuzz is not None and proof.fuzz.finding:
        return Status(
            StatusWord.UNSAFE, f"The bits agree, but with random bits at its entrances: {proof.fuzz.finding}."
        )
    where = "".join(f", of {each.steps} on an emulated {each.target.title}" for each in proof.targets)
    sentence = f"All bits of {proof.steps} steps and of the self-test are the twin's, compiled by {proof.compiler}"
    random = "" if proof.fuzz is None else f" {proof.fuzz.steps} random steps under the sanitizers found nothing."
    return Status(StatusWord.OK, " ".join([f"{sentence}{where}.{random}", *proof.missing]))


_NO_COMPILER = (
    "No C compiler was found (cc, gcc, clang or $CC), so nothing was compared; install one and verify again, or run"
    " 'make check' in the folder elsewhere."
)
