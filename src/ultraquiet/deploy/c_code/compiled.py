"""The compiled code as a controller in this process."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.law.law import Law, Rounded
from ultraquiet.deploy.toolchain.compiler import FLAGS, compile_c
from ultraquiet.values.controller import MachineStep


class Library:
    """The generated files, compiled to a shared library and loaded; the library lives as long as the process."""

    def __init__(self, law: Law, folder: Path, cc: str, flags: tuple[str, ...] = FLAGS) -> None:
        self.law, self.folder, self.cc, self.flags = law, folder, cc, flags
        with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
            library_file = Path(work) / f"{law.name}.so"
            sources = [folder / f"{law.name}.c", folder / f"{law.name}_host.c"]
            compile_c([cc, *flags, "-fPIC", "-shared", *sources, "-o", library_file], folder)
            try:
                self._library = ctypes.CDLL(str(library_file))
            except OSError as error:
                raise ToolError(f"deploy: the compiled controller cannot be loaded ({error}).") from None

    def __reduce__(self) -> Any:
        # A loaded library does not travel to another process; its sources do.
        return Library, (self.law, self.folder, self.cc, self.flags)

    def function(self, name: str) -> Any:
        """Return an exported C function by its name after the controller's."""
        return self._library[f"{self.law.name}_{name}"]


class CompiledController(Shown):
    """u = K y by the generated code, a `Controller`; instances do not touch each other.

    In control at full command from the first step on, unless `ramp` asks for the ramp of a real start. A copy made by
    pickling starts at rest.
    """

    def __init__(self, library: Library, ramp: bool = False) -> None:
        self.library, self.ramp = library, ramp
        law = library.law
        size = int(library.function("host_size")())
        # An array of doubles keeps the alignment that a state of doubles and pointers needs.
        self._state = (ctypes.c_double * (size // 8 + 1))()
        self._y, self._u = np.zeros(law.inputs, law.dtype), np.zeros(law.outputs, law.dtype)
        self._at = [ctypes.c_void_p(a.ctypes.data) for a in (self._y, self._u)]
        self._step = library.function("host_step")
        self._step.restype = None
        self.reset()

    def __reduce__(self) -> Any:
        return CompiledController, (self.library, self.ramp)

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.library.law.rate_hz

    def reset(self) -> None:
        """Return to rest and take control."""
        if self.ramp:
            self.library.function("init")(self._state, None)
            self.library.function("enable")(self._state)
        else:
            self.library.function("host_engage")(self._state)

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        self._y[:] = y
        self._step(self._state, *self._at)
        return self._u.astype(np.float64)

    def machine_step(self) -> MachineStep:
        """Return the step as a loop of machine code calls it."""
        return MachineStep(
            function=ctypes.cast(self._step, ctypes.c_void_p).value or 0,
            state=ctypes.addressof(self._state),
            readings=self._y,
            commands=self._u,
            reads=np.arange(self._y.size),
            drives=np.arange(self._u.size),
            channels=(self._y.size, self._u.size),
            owner=self,
        )

    def run(self, y: ArrayLike) -> Rounded:
        """Return the commands `(nu, n)` in the code's precision for measurements `(ny, n)`."""
        law = self.library.law
        samples = np.ascontiguousarray(np.asarray(y, law.dtype).T)
        if samples.ndim != 2 or samples.shape[1] != law.inputs:
            raise InputError(f"CompiledController: measurements must be ({law.inputs}, n), got {samples.T.shape}.")
        u = np.empty((samples.shape[0], law.outputs), law.dtype)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (samples, u)]
        self.library.function("host_run")(self._state, *pointers, ctypes.c_uint32(samples.shape[0]))
        return u.T

    def disable(self) -> None:
        """Ramp out."""
        self.library.function("disable")(self._state)
