"""Processors that the code can be built for and run on by an emulator."""

from dataclasses import dataclass

from ultraquiet._base.constraints import one_of

COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
# At 2^10 ns an instruction the emulated SysTick of 25 MHz advances 25.6 ticks for each, so counts round exactly.
TICKS = 25.6
COUNTING = ("-icount", "shift=10", "-display", "none", "-serial", "none", "-monitor", "none")


@dataclass(frozen=True)
class Target:
    """A processor: the compiler's flags, the emulator's machine, and the clock at which times are stated.

    The clock is that of a common part with this core; a time is `instructions / clock_hz`, one instruction a cycle,
    without wait states of the memory. `doubles` tells whether it computes in float64 itself or by a library.
    """

    name: str
    title: str
    flags: tuple[str, ...]
    machine: str
    clock_hz: float
    part: str
    doubles: bool

    @property
    def emulation(self) -> tuple[str, ...]:
        """Arguments of the emulator."""
        return ("-M", self.machine, *COUNTING)

    @property
    def key(self) -> str:
        """Name as the tables spell it."""
        return self.name.replace("-", "_")

    def seconds(self, instructions: float) -> float:
        """Return the time of so many instructions at one a cycle."""
        return instructions / self.clock_hz


CORTEX_M7 = Target(
    "cortex-m7",
    "Cortex-M7",
    ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
    "mps2-an500",
    216e6,
    "STM32F7, 216 MHz",
    doubles=True,
)
CORTEX_M4F = Target(
    "cortex-m4f",
    "Cortex-M4F",
    ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    "mps2-an386",
    168e6,
    "STM32F4, 168 MHz",
    doubles=False,
)
TARGETS = {target.name: target for target in (CORTEX_M4F, CORTEX_M7)}


def target_named(name: str) -> Target:
    """Return a target by its name.

    >>> target_named("cortex-m7").machine
    'mps2-an500'
    """
    return TARGETS[one_of("deploy", "target", name, tuple(TARGETS))]
