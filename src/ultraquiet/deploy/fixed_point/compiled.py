"""The compiled whole-number code as a controller in this process."""

import ctypes
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole
from ultraquiet.deploy.fixed_point.twin import words
from ultraquiet.deploy.toolchain.compiler import FLAGS, call, compile_c


class FixedCode:
    """The compiled whole-number code as a `Controller`, volts in and out through converters of its word."""

    def __init__(self, law: FixedLaw, folder: Path, cc: str) -> None:
        self.law = law
        with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
            library_file = Path(work) / f"{law.name}.so"
            sources = [folder / f"{law.name}.c", folder / f"{law.name}_host.c"]
            compile_c([cc, *FLAGS, "-fPIC", "-shared", *sources, "-o", library_file], folder)
            self._library = ctypes.CDLL(str(library_file))
        size = int(self._library[f"{law.name}_host_size"]())
        self._state = (ctypes.c_uint64 * (size // 8 + 1))()
        self._type = np.dtype(f"i{law.bits // 8}")
        self.reset()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    def reset(self) -> None:
        """Return to rest and take control at full command."""
        self._library[f"{self.law.name}_host_engage"](self._state)

    def run(self, y: ArrayLike) -> Whole:
        """Return the commands `(nu, n)` for measurements `(ny, n)`, both words."""
        samples = np.ascontiguousarray(np.asarray(y).T, self._type)
        u = np.empty((len(samples), self.law.outputs), self._type)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (samples, u)]
        self._library[f"{self.law.name}_host_run"](self._state, *pointers, ctypes.c_uint32(len(samples)))
        return u.T.astype(np.int64)

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` in volts for measurements `(ny,)` and advance."""
        u = self.run(words(y, self.law.input_v, self.law.bits)[:, None])[:, 0]
        return u.astype(np.float64) * (self.law.output_v / 2.0 ** (self.law.bits - 1))


def self_test_passes(law: FixedLaw, folder: Path, cc: str) -> bool:
    """Compile and run the shipped self-test."""
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        program = Path(work) / "selftest"
        sources = [folder / f"{law.name}.c", folder / f"{law.name}_selftest.c"]
        compile_c([cc, *FLAGS, f"-D{law.name.upper()}_MAIN", *sources, "-o", program], folder)
        return call([program], Path(work)).returncode == 0
