"""The code on an emulated processor: its self-test, its bits over a long run, and its instructions, counted exactly."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.law.law import Law, Rounded
from ultraquiet.deploy.toolchain.compiler import FLAGS, call, compile_c
from ultraquiet.deploy.toolchain.target import Target
from ultraquiet.deploy.toolchain.targets import reference_target

SECONDS = 300.0
ASK_STEP, ASK_ENGAGE, ASK_START, ASK_DISABLE = range(4)  # the harness's words for a frame
FRAMES, REPLIES = "frames", "replies"
SLACK = 128  # ticks: the compiler may put a few instructions more between the readings
CALIBRATION = 1000  # single instructions between two readings of the clock


@dataclass(frozen=True)
class InstructionCount:
    """Instructions of the two halves of a step, guards included, and whether the self-test passed on the target."""

    output: int
    update: int
    self_test: bool

    @property
    def step(self) -> int:
        """Instructions of a whole step."""
        return self.output + self.update


@dataclass(frozen=True, eq=False)
class TargetRun:
    """Commands `(nu, n)` in the code's precision, instructions of each half of each step `(n,)`."""

    u: Rounded
    output: NDArray[np.int64]
    update: NDArray[np.int64]

    @property
    def step(self) -> NDArray[np.int64]:
        """Instructions of each whole step `(n,)`."""
        return self.output + self.update


def build(law: Law, folder: Path, work: Path, target: Target) -> Path:
    """Return the program for the target, built in `work` from the folder's files.

    Raises:
        ToolError: the compiler is missing or refuses.
    """
    target.require_programs()
    program, family = work / f"{target.key}.elf", target.family
    sources = [folder / f"{law.name}{part}.c" for part in ("", "_selftest", f"_{family.stem}")]
    link = ("-nostdlib", "-nostartfiles", "-T", folder / f"{law.name}_{target.script}.ld")
    compile_c([family.compiler, *FLAGS, *target.flags, *sources, *link, "-lgcc", "-o", program], folder)
    return program


def count_instructions(law: Law, folder: Path, target: Target | None = None) -> InstructionCount:
    """Build the folder's code for the target, run its self-test there and count a step (the longest of 64).

    Raises:
        ToolError: a program is missing, refuses, or says nothing that can be read.
    """
    target = target or reference_target()
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        program = build(law, folder, Path(work), target)
        completed = call(target.command(program), Path(work), SECONDS)
    return _read(completed.stdout + completed.stderr, target.ticks)


def run_on_target(law: Law, folder: Path, y: ArrayLike, target: Target | None = None, ramp: bool = True) -> TargetRun:
    """Return what the target commands for measurements `(ny, n)` from rest, and what each step costs it.

    Args:
        law: the law that `folder` holds the code of.
        folder: generated files.
        y: measurements in volts.
        target: the processor; the reference when absent.
        ramp: start with the ramp of a real start, else at full command.

    Raises:
        ToolError: a program is missing, refuses, or ends early.
    """
    target, measurements = target or reference_target(), np.asarray(y, law.dtype)
    frames = np.zeros(measurements.shape[1] + 1, frame_type(law))
    frames["ask"][0] = ASK_START if ramp else ASK_ENGAGE
    frames["y"][1:] = measurements.T
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        program = build(law, folder, Path(work), target)
        frames.tofile(Path(work) / FRAMES)
        completed = call(target.command(program), Path(work), SECONDS)
        path = Path(work) / REPLIES
        answers = path.read_bytes() if path.exists() else b""
    replies = np.frombuffer(
        answers[: len(answers) // reply_type(law).itemsize * reply_type(law).itemsize], reply_type(law)
    )
    if replies.size != frames.size:
        words = " ".join((completed.stdout + completed.stderr).split())[:200]
        steps = frames.size - 1
        raise ToolError(f"deploy: the emulated {target.title} ended after {replies.size} of {steps} steps: {words!r}.")
    return TargetRun(replies["u"][1:].T, *instructions(replies[0], replies[1:], target.ticks))


def frame_type(law: Law) -> np.dtype[Any]:
    """Return the layout of a question to the target."""
    return np.dtype([("ask", "<u4"), ("spare", "<u4"), ("y", law.dtype, (law.inputs,))])


def reply_type(law: Law) -> np.dtype[Any]:
    """Return the layout of its answer."""
    return np.dtype([("output", "<u4"), ("update", "<u4"), ("u", law.dtype, (law.outputs,))])


def instructions(calibration: Any, replies: Any, ticks: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return instructions of each half of steps from ticks of the clock; the first reply to a start calibrates it."""
    empty = float(calibration["output"])
    _require_clock(empty, float(calibration["update"]), ticks)
    output, update = (np.rint((replies[half].astype(float) - empty) / ticks) for half in ("output", "update"))
    return output.astype(np.int64), update.astype(np.int64)


def _read(words: str, ticks: float) -> InstructionCount:
    pairs = [line.split() for line in words.splitlines()]
    ticks_of = {pair[0]: int(pair[1]) for pair in pairs if len(pair) == 2 and pair[1].isdigit()}
    if not {"empty", "thousand", "output", "update", "self-test"} <= ticks_of.keys():
        raise ToolError(f"deploy: the emulator's words make no sense: {' '.join(words.split())[:200]!r}.")
    _require_clock(ticks_of["empty"], ticks_of["thousand"], ticks)
    output, update = (round((ticks_of[key] - ticks_of["empty"]) / ticks) for key in ("output", "update"))
    return InstructionCount(output, update, ticks_of["self-test"] == 0)


def _require_clock(empty: float, thousand: float, ticks: float) -> None:
    """Refuse to count by a clock whose ticks an instruction are not what the counts are divided by."""
    if abs(thousand - empty - CALIBRATION * ticks) > SLACK:
        seen = (thousand - empty) / CALIBRATION
        raise ToolError(f"deploy: the emulator's clock ticks {seen:.3f} times an instruction, not {ticks:g}.")
