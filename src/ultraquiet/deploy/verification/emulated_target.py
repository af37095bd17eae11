"""What an emulated processor made of the code: its bits beside the twin's, its instructions, its time."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.footprint import footprint_on
from ultraquiet.deploy.law.law import Law, Rounded
from ultraquiet.deploy.toolchain.emulator import TargetRun, count_instructions, run_on_target
from ultraquiet.deploy.toolchain.target import Target

# Emulated sums by a library take some hundred times as long as a unit's.
STEPS, STEPS_IN_SOFTWARE = 100_000, 2_000


@dataclass(frozen=True)
class OnTarget(Shown):
    """One target: commands that differ from the twin's, instructions of a step, bytes.

    `step` and `output` are the most instructions that a step and its first half took in the run, with its limits, ramps
    and faults; `calm` the fewest and the most of steps at full command inside the limits (None when there were none).
    `flash_bytes` holds the compiler's library too, `stack_bytes` is the deepest chain of calls without it.
    """

    target: Target
    self_test: bool
    steps: int
    mismatches: int
    step: int
    output: int
    calm: tuple[int, int] | None
    flash_bytes: int | None
    stack_bytes: int | None

    @property
    def bit_exact(self) -> bool:
        """True when no command differed and the self-test passed."""
        return self.mismatches == 0 and self.self_test

    @property
    def constant(self) -> bool:
        """True when every calm step took the same number of instructions."""
        return self.calm is not None and self.calm[0] == self.calm[1]

    @property
    def latency_us(self) -> float:
        """Time from measurements to commands at the target's clock, one instruction a cycle."""
        return 1e6 * self.target.seconds(self.output)

    def __str__(self) -> str:
        same = "bit-exact" if self.bit_exact else f"{self.mismatches} commands differ"
        return (
            f"{self.target.title}: {same} over {self.steps} steps, {self.step} instructions a step, "
            f"output after {self.output} ({self.latency_us:.1f} us at {self.target.clock_hz / 1e6:g} MHz)"
        )


def try_on_target(law: Law, folder: Path, y: Rounded, expected: Rounded, target: Target) -> OnTarget:
    """Run self-test and measurements `(ny, n)` on a target and compare with the `expected` commands `(nu, n)`.

    Raises:
        ToolError: a program is missing, refuses, or ends early.
    """
    limit = STEPS if law.precision in target.in_hardware else STEPS_IN_SOFTWARE
    steps = min(y.shape[1], limit)
    tested = count_instructions(law, folder, target)
    run = run_on_target(law, folder, y[:, :steps], target)
    size = footprint_on(law, folder, target)
    return OnTarget(
        target=target,
        self_test=tested.self_test,
        steps=steps,
        mismatches=differing(run.u, expected[:, :steps])[0],
        step=max(int(run.step.max()), tested.step),
        output=max(int(run.output.max()), tested.output),
        calm=_calm(law, y[:, :steps], run),
        flash_bytes=size.flash_bytes,
        stack_bytes=size.stack_bytes,
    )


def differing(one: Rounded, other: Rounded) -> tuple[int, tuple[int, int] | None]:
    """Return how many commands differ in at least one bit, and the (step, output) of the first."""
    word = f"u{one.dtype.itemsize}"
    differs = np.ascontiguousarray(one.T).view(word) != np.ascontiguousarray(other.T).view(word)
    if not differs.any():
        return 0, None
    step, output = np.argwhere(differs)[0]
    return int(np.count_nonzero(differs)), (int(step), int(output))


def _calm(law: Law, y: Rounded, run: TargetRun) -> tuple[int, int] | None:
    """Return the fewest and the most instructions of steps after the ramp, inside the limits, before a fault."""
    calm: NDArray[np.bool_] = np.cumprod(np.isfinite(y).all(axis=0)).astype(bool)
    calm[: law.ramp_steps] = False
    calm &= ((run.u > law.limits[:, :1]) & (run.u < law.limits[:, 1:])).all(axis=0)
    took = run.step[calm]
    return (int(took.min()), int(took.max())) if took.size else None
