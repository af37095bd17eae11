"""Processor in the loop: the program of the target under an emulator, one exchange a sample."""

import contextlib
import os
import select
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.law.law import Rounded, require_floating
from ultraquiet.deploy.toolchain.emulator import (
    ASK_DISABLE,
    ASK_ENGAGE,
    ASK_START,
    ASK_STEP,
    FRAMES,
    REPLIES,
    build,
    frame_type,
    instructions,
    reply_type,
)
from ultraquiet.deploy.toolchain.targets import target_named

ANSWER_S = 10.0  # a step takes some ten microseconds of emulation; the machine may be busy with other work
LOOK_S = 0.1  # how often a silent emulator is asked whether it lives
LAST_WORDS_S = 2.0


class Processor(Shown):
    """u = K y by the real binary of a target under an emulator, a `Controller`.

    Each step sends the measurements to the emulated processor and waits for its commands, so `bench.run(...,
    controller=processor)` closes the loop through the very instructions that would run on the part, with the bits of
    the code compiled here. The emulator counts: `instructions` holds what every step took, `output` and `update`.
    In control at full command from the first step on, unless `ramp` asks for the ramp of a real start.

    Args:
        deployment: what `generate` returned.
        target: name of an emulated processor, `cortex-m7` say.
        ramp: start, and start again at each `reset`, with the ramp.
        timeout_s: seconds after which a silent emulator is given up.

    Raises:
        InputError: an unknown target.
        ToolError: compiler or emulator are missing, refuse, fall silent or die.

    Use it in a `with` block, which ends the emulator. It counts instructions, not cycles, and knows no converters:
    times in the loop are those of the bench.

    >>> from ultraquiet import deploy
    >>> deploy.Processor.__name__
    'Processor'
    """

    def __init__(
        self, deployment: GeneratedCode, target: str = "cortex-m7", ramp: bool = False, timeout_s: float = ANSWER_S
    ) -> None:
        require_floating("Processor", deployment)
        self.law, self.target, self.ramp = deployment.law, target_named(target), ramp
        self.timeout_s = positive("Processor", "timeout_s", timeout_s, "s")
        self._frame, self._reply = np.zeros(1, frame_type(self.law)), np.zeros(1, reply_type(self.law))
        self._answer = self._reply.view(np.uint8).data
        self._ticks: list[tuple[int, int]] = []
        self._calibration: Any = None
        self._ends: list[int] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._work = tempfile.TemporaryDirectory(prefix="ultraquiet-")
        try:
            self._start(deployment.folder)
            self.reset()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    @property
    def instructions(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Instructions of `output` and of `update`, each `(n,)`, of the steps since the last `reset`."""
        ticks = np.array(self._ticks, dtype=np.int64).reshape(-1, 2)
        return instructions(self._calibration, {"output": ticks[:, 0], "update": ticks[:, 1]}, self.target.ticks)

    def reset(self) -> None:
        """Return to rest and take control."""
        self._ask(ASK_START if self.ramp else ASK_ENGAGE)
        self._calibration = self._reply[0].copy()
        self._ticks.clear()

    def disable(self) -> None:
        """Ramp out."""
        self._ask(ASK_DISABLE)

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        if np.shape(y) != (self.law.inputs,):
            raise InputError(f"Processor: a sample must be ({self.law.inputs},), got {np.shape(y)}.")
        self._frame["y"][0] = y
        self._ask(ASK_STEP)
        reply = self._reply[0]
        self._ticks.append((int(reply["output"]), int(reply["update"])))
        return reply["u"].astype(np.float64)

    def run(self, y: ArrayLike) -> Rounded:
        """Return the commands `(nu, n)` in the code's precision for measurements `(ny, n)`, one exchange a sample."""
        measurements = np.asarray(y, self.law.dtype)
        if measurements.ndim != 2 or measurements.shape[0] != self.law.inputs:
            raise InputError(f"Processor: measurements must be ({self.law.inputs}, n), got {measurements.shape}.")
        return np.stack([self.step(sample) for sample in measurements.T], axis=1).astype(self.law.dtype)

    def close(self) -> None:
        """End the emulator; may be called again."""
        for end in self._ends:
            os.close(end)
        self._ends = []
        if self._process is not None:
            # With its pipes gone the program ends by itself; an emulator that does not is ended.
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(LAST_WORDS_S)
            self._process.kill()
            self._process.communicate()
            self._process = None
        self._work.cleanup()

    def _start(self, folder: Path) -> None:
        if not hasattr(os, "mkfifo"):
            raise ToolError("Processor: this system has no named pipes, through which the emulator is spoken to.")
        work = Path(self._work.name)
        program = build(self.law, folder, work, self.target)
        for name in (FRAMES, REPLIES):
            os.mkfifo(work / name)
        # Opened for both directions, a pipe waits for nobody; replies are opened for reading alone, so that the
        # emulator's death reads as an end of file.
        self._ends.append(os.open(work / REPLIES, os.O_RDONLY | os.O_NONBLOCK))
        self._ends.append(os.open(work / FRAMES, os.O_RDWR))
        command = [str(part) for part in self.target.command(program)]
        try:
            self._process = subprocess.Popen(
                command, cwd=work, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
            )
        except OSError as error:
            raise ToolError(f"Processor: '{command[0]}' did not start ({error}).") from None

    def _ask(self, what: int) -> None:
        if self._process is None:
            raise ToolError("Processor: the emulator was closed; make a new Processor.")
        replies, frames = self._ends
        self._frame["ask"][0] = what
        os.write(frames, self._frame.data)
        have = 0
        while have < len(self._answer):
            self._wait(replies)
            got = os.readv(replies, [self._answer[have:]])
            if got == 0:
                raise self._dead()
            have += got

    def _wait(self, replies: int) -> None:
        """Return when an answer or the pipe's end is there."""
        until = time.monotonic() + self.timeout_s
        while not select.select([replies], [], [], LOOK_S)[0]:
            if self._process is None or self._process.poll() is not None:
                raise self._dead()
            if time.monotonic() > until:
                raise ToolError(f"Processor: the emulated {self.target.title} did not answer for {self.timeout_s:g} s.")

    def _dead(self) -> ToolError:
        output = b""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                output, _ = self._process.communicate(timeout=LAST_WORDS_S)
        words = " ".join(output.decode(errors="replace").split())[:200]
        return ToolError(
            f"Processor: the emulated {self.target.title} ended after {len(self._ticks)} steps, saying {words!r}."
        )
