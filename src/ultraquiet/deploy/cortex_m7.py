"""Instructions of a step on a Cortex-M7, counted by an emulator that counts exactly."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.emit import EMULATION, FLAGS, M7_FLAGS
from ultraquiet.deploy.law import Law
from ultraquiet.deploy.toolchain import call, compile_c

COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
SECONDS = 300.0


@dataclass(frozen=True)
class Count:
    """Instructions of the two halves of a step, guards included, and whether the self-test passed on the target."""

    output: int
    update: int
    self_test: bool

    @property
    def step(self) -> int:
        """Instructions of a whole step."""
        return self.output + self.update


def missing_tool() -> str | None:
    """Return the name of a program that is not installed, None when all are."""
    return next((tool for tool in (COMPILER, EMULATOR) if shutil.which(tool) is None), None)


def count_instructions(law: Law, folder: Path) -> Count:
    """Build the folder's code for a Cortex-M7, run its self-test there and count a step (the longest of 64).

    Raises:
        ToolError: a program is missing, refuses, or says nothing that can be read.
    """
    absent = missing_tool()
    if absent is not None:
        raise ToolError(f"deploy: '{absent}' is not installed, so nothing was counted on a Cortex-M7.")
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        program = Path(work) / "program.elf"
        sources = [folder / f"{law.name}{part}.c" for part in ("", "_selftest", "_m7")]
        link = ("-nostdlib", "-nostartfiles", "-T", folder / f"{law.name}_m7.ld")
        compile_c([COMPILER, *FLAGS, *M7_FLAGS, *sources, *link, "-lgcc", "-o", program], folder)
        semihosting = ("-semihosting-config", "enable=on,target=native")
        told = call([EMULATOR, *EMULATION, *semihosting, "-kernel", program], Path(work), SECONDS)
    return _read(told.stdout + told.stderr)


def _read(words: str) -> Count:
    pairs = [line.split() for line in words.splitlines()]
    held = {pair[0]: int(pair[1]) for pair in pairs if len(pair) == 2 and pair[1].isdigit()}
    if not {"empty", "thousand", "output", "update", "self-test"} <= held.keys():
        raise ToolError(f"deploy: the emulator's words make no sense: {' '.join(words.split())[:200]!r}.")
    ticks = (held["thousand"] - held["empty"]) / 1000
    output, update = (round((held[key] - held["empty"]) / ticks) for key in ("output", "update"))
    return Count(output, update, held["self-test"] == 0)
