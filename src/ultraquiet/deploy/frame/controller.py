"""The law on a bench, sample by sample, inside its real-time frame."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.frame.clock import FrameClock
from ultraquiet.deploy.frame.harness import FrameHarness
from ultraquiet.deploy.frame.settings import FrameSettings, frame_settings
from ultraquiet.deploy.frame.times import FrameTimes
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain import compiler

MOST_SAMPLES = 2**19  # 150 s at 3.5 kHz


class FrameController(Shown):
    """A `Controller` whose samples are frames: overruns skip samples, and a command that is late is applied late.

    A command counts for the sample in which the converters are written; the bench then holds it to the next one. What
    it cannot show is the shift of a sampling instant inside its period.
    """

    def __init__(
        self, frame: FrameSettings, generated: GeneratedCode, times: FrameTimes, seed: int, ramp: bool
    ) -> None:
        self.law, self.ramp = generated.law, ramp
        self._settings = frame_settings(frame, times, generated.law.rate_hz)
        self._draws = frame.draw(MOST_SAMPLES, self._settings["period_s"], seed)
        cc = compiler.compiler()
        self._harness = None if cc is None else FrameHarness(generated.law, generated.folder, cc)
        self.reset()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    @property
    def overruns(self) -> int:
        """Overruns counted by the code since the last reset."""
        return int(self._clock.code.overruns)

    def reset(self) -> None:
        """Return to rest at the first frame, in control at full command unless `ramp` was asked for."""
        if self._harness is not None:
            self._harness.start(engage=not self.ramp)
            code = self._harness
        else:
            code = Twin(self.law)
            code.reset()
            code.level = 0 if self.ramp else code.level
        self._clock, self._k = FrameClock(code, self._settings, self._draws), 0
        self._on_converters = self._following = np.zeros(self.law.outputs)

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` that the converters hold when this sample's frame ends."""
        if self._k >= MOST_SAMPLES:
            raise InputError(f"FrameController: its {MOST_SAMPLES} frames are over; call reset().")
        clock = self._clock
        with np.errstate(all="ignore"):
            clock.tick(self._k, np.asarray(y, self.law.dtype))
        self._k += 1
        if clock.open_at == self._k - 1:
            self._on_converters, self._following = self._following, clock.command.astype(np.float64)
        if clock.written <= self._k * self._settings["period_s"]:
            self._on_converters = self._following
        return self._on_converters
