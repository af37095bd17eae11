"""What a processor must say of itself so that the code can be built for it, run on it and counted."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from ultraquiet._base.errors import ToolError


@dataclass(frozen=True)
class Memory:
    """Where the emulated board has memory for code and constants, and for data and stack: addresses."""

    code: int
    data: int


@dataclass(frozen=True)
class Family:
    """Processors that share a compiler, an emulator and the program that is put around the code.

    `stem` names that program's files, NAME_stem.c and NAME_stem.ld; `folder` holds their templates. The emulator must
    count: `counting` are the arguments that make its clock advance with the instructions. `memory` is that of its usual
    boards, `packages` are those of Debian that bring the programs, `processor` is CMake's word for the family.
    """

    stem: str
    folder: Path
    compiler: str
    size_tool: str
    emulator: str
    counting: tuple[str, ...]
    semihosting: tuple[str, ...]
    memory: Memory
    packages: tuple[str, ...]
    processor: str

    @property
    def programs(self) -> tuple[str, str]:
        """Compiler and emulator."""
        return self.compiler, self.emulator

    def template(self, name: str) -> str:
        """Return the name under which the family's template is rendered."""
        return f"{self.folder.name}/{name}"

    def missing_program(self) -> str | None:
        """Return the name of a program that is not installed, None when both are."""
        return next((program for program in self.programs if shutil.which(program) is None), None)


@dataclass(frozen=True)
class Target:
    """A processor: the compiler's flags, the emulator's machine, and the clock at which times are stated.

    The clock is that of a common part with this core; a time is `instructions / clock_hz`, one instruction a cycle,
    without wait states of the memory. `in_hardware` names the precisions that it computes in itself, the others go
    through a library. `ticks` of the emulated machine's clock pass in an instruction. `memory` is that of the machine
    where it is not the family's, which takes a linker script of its own.
    """

    family: Family
    name: str
    title: str
    flags: tuple[str, ...]
    machine: str
    ticks: float
    clock_hz: float
    part: str
    in_hardware: tuple[str, ...]
    memory: Memory | None = None

    @property
    def emulation(self) -> tuple[str, ...]:
        """Arguments of the emulator that choose the machine and make it count."""
        return ("-M", self.machine, *self.family.counting)

    @property
    def key(self) -> str:
        """Name as the tables spell it."""
        return self.name.replace("-", "_")

    @property
    def script(self) -> str:
        """What the linker script's name says after the law's."""
        return self.family.stem if self.memory is None else self.key

    def seconds(self, instructions: float) -> float:
        """Return the time of so many instructions at one a cycle."""
        return instructions / self.clock_hz

    def command(self, program: Path) -> list[str | Path]:
        """Return the command that runs a program on the emulated processor."""
        family = self.family
        return [family.emulator, *self.emulation, *family.semihosting, "-kernel", program]

    def require_programs(self) -> None:
        """Refuse when compiler or emulator is missing.

        Raises:
            ToolError: names the program.
        """
        absent = self.family.missing_program()
        if absent is not None:
            raise ToolError(f"deploy: '{absent}' is not installed, so nothing was run or counted on a {self.title}.")
