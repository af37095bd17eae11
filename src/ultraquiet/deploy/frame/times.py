"""How long the parts of one frame take on a processor: instructions counted or modelled, at a stated clock."""

from dataclasses import dataclass, fields

import numpy as np

from ultraquiet._base.constraints import between, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.c_code.self_test import HALF_RANGE
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.toolchain.emulator import run_on_target
from ultraquiet.deploy.toolchain.targets import target_named

# 50 ns an instruction, section 4.2 of the paper.
C31_CLOCK_HZ = 20e6
# The frame's skeleton of 142 instructions in its four parts. Only their sum is an anchor of the C31 model; how they
# share it is assumed: context saved and restored, then for each of six converters a read that is scaled to a number
# and a number that is scaled and written.
ENTRY, READ, WRITE, LEAVE = 20, 54, 54, 14
LONGEST_S = 1.0
COUNTED_STEPS, IDLE_FROM = 64, 8


@dataclass(frozen=True)
class FrameTimes(Shown):
    """Seconds of processor time that each part of a frame needs when nothing disturbs it.

    A frame is: interrupt entry, converters read, `output`, converters written, `update`, return. `idle_output_s` and
    `idle_update_s` are the two halves while the law is off or in fault, when only the guards run. `source` says where
    the numbers come from.
    """

    entry_s: float
    read_s: float
    output_s: float
    write_s: float
    update_s: float
    leave_s: float
    idle_output_s: float = 0.0
    idle_update_s: float = 0.0
    source: str = "given"

    def __post_init__(self) -> None:
        for field in fields(self)[:-1]:
            between("FrameTimes", field.name, getattr(self, field.name), 0.0, LONGEST_S, "s")

    @property
    def skeleton_s(self) -> float:
        """Time of the frame around the law."""
        return self.entry_s + self.read_s + self.write_s + self.leave_s

    @property
    def step_s(self) -> float:
        """Time of a whole frame with the law in control."""
        return self.skeleton_s + self.output_s + self.update_s

    @property
    def latency_s(self) -> float:
        """Time from the interrupt to commands written."""
        return self.entry_s + self.read_s + self.output_s + self.write_s

    @classmethod
    def c31(cls, law: Law) -> "FrameTimes":
        """Return the times of the TMS320C31-40 model, 50 ns an instruction; the guards are no part of that model.

        >>> from ultraquiet.deploy.law.realisation import realisation
        >>> from ultraquiet.deploy.law.law import actuator_limits
        >>> from ultraquiet.deploy.law.rounding import rounded
        >>> from ultraquiet.values import StateSpace
        >>> gain = realisation(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=3500.0), "modal")
        >>> law = rounded(gain, None, actuator_limits(1.0, 1), "float32", rate_hz=3500.0, order=1)
        >>> round(1e6 * FrameTimes.c31(law).skeleton_s, 3)
        7.1
        """
        kernel = cycles.kernel_of(law)
        output = min(kernel, cycles.output_cycles(law))
        return cls._of(output, kernel - output, 0, 0, C31_CLOCK_HZ, "TMS320C31-40 model, 50 ns an instruction")

    @classmethod
    def counted(
        cls,
        output: int,
        update: int,
        clock_hz: float,
        *,
        idle_output: int | None = None,
        idle_update: int | None = None,
        cycles_per_instruction: float = 1.0,
        title: str = "processor",
    ) -> "FrameTimes":
        """Return the times of counted instructions at a clock.

        Converters and interrupt take the instructions of the C31's skeleton: replace them where the hardware's own are
        known (`dataclasses.replace`).

        Args:
            output: instructions of the first half of a step, guards included.
            update: instructions of the second half.
            clock_hz: processor clock in Hz.
            idle_output: the same while the law is off; as many as in control when absent.
            idle_update: the same.
            cycles_per_instruction: 1 without wait states and stalls; the user's own figure otherwise.
            title: the processor's name.
        """
        off_output = output if idle_output is None else idle_output
        off_update = update if idle_update is None else idle_update
        for name, count in (("output", output), ("update", update), ("idle", off_output), ("idle", off_update)):
            whole("FrameTimes", name, count, 0)
        clock = positive("FrameTimes", "clock_hz", clock_hz, "Hz")
        each = positive("FrameTimes", "cycles_per_instruction", cycles_per_instruction)
        source = f"{title}, counted instructions, {clock / 1e6:g} MHz, {each:g} cycles each"
        return cls._of(output, update, off_output, off_update, clock / each, source)

    @classmethod
    def on_target(
        cls,
        made: GeneratedCode,
        target: str = "cortex-m7",
        *,
        clock_hz: float | None = None,
        cycles_per_instruction: float = 1.0,
    ) -> "FrameTimes":
        """Return the times of the code as an emulated Cortex-M counts it, in control and off.

        Args:
            made: what `generate` has returned.
            target: name of an emulated processor, `cortex-m7` say.
            clock_hz: processor clock in Hz; that of a common part when absent.
            cycles_per_instruction: 1 without wait states and stalls.

        Raises:
            ToolError: the target's compiler or emulator is missing or refuses.
        """
        law, chosen = made.law, target_named(target)
        y = np.random.default_rng(0).standard_normal((law.inputs, COUNTED_STEPS)) * made.plan.loud * HALF_RANGE
        live = run_on_target(law, made.folder, y, chosen, ramp=False)  # loud enough to meet limits
        y[:, 0] = np.nan  # in fault and out of its ramp after a few steps: the guards alone
        idle = run_on_target(law, made.folder, y, chosen)
        return cls.counted(
            int(live.output.max()),
            int(live.update.max()),
            chosen.clock_hz if clock_hz is None else clock_hz,
            idle_output=int(idle.output[IDLE_FROM:].max()),
            idle_update=int(idle.update[IDLE_FROM:].max()),
            cycles_per_instruction=cycles_per_instruction,
            title=chosen.title,
        )

    @classmethod
    def _of(
        cls, output: int, update: int, idle_output: int, idle_update: int, rate: float, source: str
    ) -> "FrameTimes":
        counts = (ENTRY, READ, output, WRITE, update, LEAVE, idle_output, idle_update)
        entry, read, out, write, advance, leave, off_out, off_advance = (count / rate for count in counts)
        return cls(entry, read, out, write, advance, leave, off_out, off_advance, source)

    def require_room(self, period_s: float) -> None:
        """Refuse a frame that its own skeleton fills.

        Raises:
            InputError: the period and the skeleton's time.
        """
        if self.skeleton_s >= period_s:
            raise InputError(
                f"Frame: a frame of {1e6 * period_s:.4g} us is shorter than its skeleton (interrupt and converters) of"
                f" {1e6 * self.skeleton_s:.4g} us; take a lower rate or a faster processor."
            )
