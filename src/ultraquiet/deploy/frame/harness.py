"""The frame's simulation around the compiled code, and around its twin where no compiler is."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import signal_array
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.plan import CodePlan, GeneratedCode
from ultraquiet.deploy.c_code.self_test import HALF_RANGE
from ultraquiet.deploy.frame.clock import FrameClock, empty_arrays, run_clock
from ultraquiet.deploy.frame.result import FrameSimulation, judge
from ultraquiet.deploy.frame.settings import Draws, FrameSettings, frame_settings
from ultraquiet.deploy.frame.times import FrameTimes
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain import compiler

# Measurements that are drawn and then repeated.
NOISE_SAMPLES = 4096
_SECONDS = (
    "period_s",
    "entry_s",
    "read_s",
    "output_s",
    "write_s",
    "update_s",
    "leave_s",
    "idle_output_s",
    "idle_update_s",
    "background_s",
    "service_s",
)
_COUNTS = ("restart", "frames", "samples", "arrivals")
_GIVEN = ("delay", "stretch", "extra", "arrival", "y")
_FILLED = ("start", "written", "finish", "done", "largest", "mode", "faults", "skipped", "late", "level", "overruns")
_TOLD = ("hooked", "refused")


class Job(ctypes.Structure):
    """The harness's argument, field by field."""

    _fields_ = [
        *((name, ctypes.c_double) for name in _SECONDS),
        *((name, ctypes.c_uint32) for name in _COUNTS),
        *((name, ctypes.c_void_p) for name in (*_GIVEN, *_FILLED)),
        *((name, ctypes.c_uint32) for name in _TOLD),
    ]


class FrameHarness:
    """The folder's controller compiled together with the harness; one instance of the law."""

    def __init__(self, law: Law, folder: Path, cc: str) -> None:
        self.law = law
        with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
            source, library_file = Path(work) / "frame.c", Path(work) / "frame.so"
            text = render.render("frame_harness.c.j2", {"name": law.name, "NAME": law.name.upper()})
            source.write_text(text, encoding="utf-8")
            own = folder / f"{law.name}.c"
            compiler.compile_c(
                [cc, *compiler.FLAGS, f"-I{folder}", "-fPIC", "-shared", own, source, "-o", library_file], folder
            )
            try:
                self._library = ctypes.CDLL(str(library_file))
            except OSError as error:
                raise ToolError(f"deploy: the compiled controller cannot be loaded ({error}).") from None
        size = int(self._function("frame_size")())
        self._state = (ctypes.c_double * (size // 8 + 1))()
        self._seen = (ctypes.c_uint32 * 5)()
        self._y, self._u = np.zeros(law.inputs, law.dtype), np.zeros(law.outputs, law.dtype)
        for name in ("frame", "enable", "clear"):
            self._function(name).restype = ctypes.c_bool
        self.start()

    def _function(self, name: str) -> Any:
        return getattr(self._library, f"{self.law.name}_{name}")

    def _look(self, item: int) -> int:
        self._function("frame_look")(self._state, self._seen)
        return int(self._seen[item])

    mode = property(lambda self: self._look(0))
    level = property(lambda self: self._look(1))
    overruns = property(lambda self: self._look(2))
    hooked = property(lambda self: self._look(3))
    faults = property(lambda self: self._look(4))

    def start(self, engage: bool = False) -> None:
        """Initialise with the counting hook, and enable; `engage` at full command from the first step on."""
        self._function("frame_start")(self._state, ctypes.c_uint32(engage))

    def frame(self) -> bool:
        """Tell whether a step may begin."""
        return bool(self._function("frame")(self._state))

    def output(self, y: NDArray[Any]) -> NDArray[Any]:
        """Return the commands of this step."""
        self._y[:] = y
        self._function("output")(self._state, *(ctypes.c_void_p(a.ctypes.data) for a in (self._y, self._u)))
        return self._u.copy()

    def update(self) -> None:
        """Advance the state."""
        self._function("update")(self._state)

    def enable(self) -> bool:
        """Ramp in."""
        return bool(self._function("enable")(self._state))

    def clear(self) -> bool:
        """Clear a latched fault."""
        return bool(self._function("clear")(self._state))

    def run(self, settings: dict[str, Any], draws: Draws, frames: int, y: NDArray[Any]) -> dict[str, Any]:
        """Return the arrays of so many frames, from a fresh start."""
        filled = empty_arrays(frames)
        drawn = {
            "delay": draws.delay_s,
            "stretch": draws.stretch,
            "extra": draws.extra_s,
            "arrival": draws.arrival_s,
            "y": np.ascontiguousarray(y, self.law.dtype),
        }
        counts = {"frames": frames, "samples": len(y), "arrivals": draws.arrival_s.size}
        pointers = {name: array.ctypes.data for name, array in (drawn | filled).items()}
        job = Job(**settings, **counts, **pointers)
        self._function("frame_run")(self._state, ctypes.byref(job))
        return filled | {"hooked": int(job.hooked), "refused": int(job.refused)}


def run_frames(
    frame: FrameSettings, code: GeneratedCode, frames: int, times: FrameTimes, measurements: ArrayLike | None, seed: int
) -> FrameSimulation:
    """Return what `Frame.simulate` promises."""
    settings = frame_settings(frame, times, code.law.rate_hz)
    draws = frame.draw(frames, settings["period_s"], seed)
    y = _measurements(code.plan, measurements, seed)
    cc = compiler.compiler()
    if cc is not None:
        arrays = FrameHarness(code.law, code.folder, cc).run(settings, draws, frames, y)
    else:
        arrays = run_twin(code.law, settings, draws, frames, y)
    return judge(frame, times, code.law, arrays, "twin" if cc is None else "compiled code")


def run_twin(law: Law, settings: dict[str, Any], draws: Draws, frames: int, y: NDArray[Any]) -> dict[str, Any]:
    """Return the arrays of so many frames of the twin, from a fresh start; some 50 us a frame."""
    twin = Twin(law)
    twin.enable()
    clock = FrameClock(twin, settings, draws)
    with np.errstate(all="ignore"):
        arrays = run_clock(clock, frames, y)
    return arrays | {"hooked": None, "refused": clock.refused}


def _measurements(plan: CodePlan, measurements: ArrayLike | None, seed: int) -> NDArray[Any]:
    """Return measurements as `(samples, inputs)` in the code's precision."""
    law = plan.law
    if measurements is None:
        noise = np.random.default_rng(seed).standard_normal((NOISE_SAMPLES, law.inputs))
        return np.ascontiguousarray(noise * plan.quiet * HALF_RANGE, law.dtype)
    y = signal_array("Frame", "measurements", measurements)
    if y.shape[0] != law.inputs or y.shape[1] == 0:
        raise InputError(f"Frame: measurements must be ({law.inputs}, n), got {y.shape}.")
    return np.ascontiguousarray(y.T, law.dtype)
