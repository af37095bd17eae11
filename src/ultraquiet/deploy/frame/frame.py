"""The real-time frame: does the step end before the next interrupt, and what happens when it does not."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.frame.controller import FrameController
from ultraquiet.deploy.frame.harness import run_frames
from ultraquiet.deploy.frame.result import FrameSimulation
from ultraquiet.deploy.frame.settings import FrameSettings
from ultraquiet.deploy.frame.times import FrameTimes
from ultraquiet.deploy.law.law import require_floating

FRAMES = 1_000_000


@dataclass(frozen=True)
class Frame(FrameSettings, Shown):
    """One processor, one timer: the step runs when the timer says so, background work fills the rest.

    At each period T the timer interrupts. While a step is unfinished (its busy flag is set) the interrupt only counts:
    `NAME_frame` returns false, that frame is skipped, the step goes on and the converters keep their command.
    Otherwise: entry, read, `output`, write, `update`, return; then background work of `load` T a frame at lower
    priority, which the next interrupt preempts and which is late when it is unfinished by then. The interrupt lets
    itself be interrupted once `output` has begun.

    Args:
        load: share of each frame that background work needs, below one; the paper gives it half.
        jitter_s: size of the interrupt's delay in seconds, never negative, below the period.
        jitter: `uniform` on [0, jitter_s], `gaussian` (the size of a normal number of that standard deviation), or
            `bursts` (16 frames in a row, one burst in 1000 frames, uniform within).
        contention: largest relative slow-down of a frame's work by bus and memory, drawn uniformly from zero to it.
        interrupt_hz: mean rate of other interrupts of higher priority, at random times; 0 for none.
        interrupt_s: time that each of them takes.
        overloads: extra work in stated frames.
        restart_s: seconds without an overrun after which a law that has ramped out is cleared and enabled again, as an
            operator would; None leaves it out.

    >>> Frame(load=1.0)
    Traceback (most recent call last):
    ...
    ultraquiet._base.errors.InputError: Frame: 'load' must lie below 1, got 1; the step needs some of the processor.

    Reference: Q. Liu et al., section 4.2 of the paper (half of 285 us for background work); C. L. Liu and J. W.
    Layland, doi:10.1145/321738.321743, for work at fixed priorities.
    """

    def simulate(
        self,
        made: GeneratedCode,
        frames: int = FRAMES,
        *,
        times: FrameTimes | None = None,
        measurements: ArrayLike | None = None,
        seed: int = 0,
    ) -> FrameSimulation:
        """Run the compiled code (without a compiler its twin) through so many frames, from its ramp on.

        Args:
            made: what `generate` has returned.
            frames: interrupts of the timer.
            times: of the frame's parts; the C31 model's when absent.
            measurements: `(ny, n)` volts, repeated as needed; noise inside the limits when absent.
            seed: of jitter, contention, interrupts and noise.

        Returns:
            A `FrameSimulation`: instants, modes, counters for each frame, and a status.

        Raises:
            InputError: a frame shorter than its skeleton, jitter of a period or more, measurements of another shape.
        """
        require_floating("Frame", made)
        return run_frames(self, made, frames, times or FrameTimes.c31(made.law), measurements, seed)

    def controller(
        self, made: GeneratedCode, *, times: FrameTimes | None = None, seed: int = 0, ramp: bool = False
    ) -> FrameController:
        """Return the law as a `Controller` for a bench: each sample is a frame, and a late command arrives late."""
        require_floating("Frame", made)
        return FrameController(self, made, times or FrameTimes.c31(made.law), seed, ramp)
