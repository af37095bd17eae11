"""A controller from a functional mock-up unit, in the house's own loops."""

import shutil
import tempfile
import weakref
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, StorageError, ToolError
from ultraquiet._base.shown import Shown

REALS = ("Real", "Float64")  # what FMI 2.0 and 3.0 call a double


class FmuController(Shown):
    """u = K y by an FMU for co-simulation (FMI 2.0 or 3.0), a `Controller`; every object is an instance of its own.

    Its real inputs are the measurements, its real outputs the commands, in the order of the description: set, step by
    one sample period, get. An FMU is foreign code in this process: one that crashes takes Python along.

    Args:
        path: the FMU file.
        rate_hz: samples per second; what the FMU proposes as a step when absent.

    Raises:
        ToolError: FMPy is not installed, or the FMU refused a call, with its last words.
        StorageError: no such file.
        InputError: not a usable FMU, no rate.
    """

    def __init__(self, path: str | Path, rate_hz: float | None = None) -> None:
        self._path, self._said = str(path), list[str]()
        try:
            import fmpy
        except ImportError as error:
            raise ToolError(
                f"FmuController: FMPy is missing ({error}); install it with 'pip install \"ultraquiet[fmu]\"'."
            ) from None
        if not Path(path).is_file():
            raise StorageError(f"FmuController: there is no file '{path}'.")
        try:
            model = fmpy.read_model_description(self._path)
        except Exception as error:  # FMPy raises whatever its parser raises
            raise InputError(f"FmuController: '{path}' cannot be read as an FMU ({error}).") from error
        if model.coSimulation is None:
            raise InputError(f"FmuController: '{path}' is no FMU for co-simulation.")
        self._old = str(model.fmiVersion).startswith("2.")
        step = getattr(model.defaultExperiment, "stepSize", None)
        if rate_hz is None and step is None:
            raise InputError(f"FmuController: '{path}' proposes no step, so 'rate_hz' must be given.")
        self._rate_hz = positive("FmuController", "rate_hz", rate_hz or 1.0 / float(step or 1.0), "Hz")
        self._y, self._u = (
            [v.valueReference for v in model.modelVariables if v.causality == kind and v.type in REALS]
            for kind in ("input", "output")
        )
        folder = tempfile.mkdtemp(prefix="ultraquiet-fmu-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        fmpy.extract(self._path, folder)
        self._slave = self._instance(model, folder)
        self._free = weakref.finalize(self, self._slave.freeInstance)
        self._k, self._fresh = 0, True
        self.reset()

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self._rate_hz

    def reset(self) -> None:
        """Return to rest."""
        slave = self._slave
        try:
            if not self._fresh:
                slave.reset()
            if self._old:
                slave.setupExperiment(startTime=0.0)
                slave.enterInitializationMode()
            else:
                slave.enterInitializationMode(startTime=0.0)
            slave.exitInitializationMode()
        except Exception as error:
            raise self._failure("at its start", error) from error
        self._k, self._fresh = 0, False

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` for measurements `(ny,)` and advance by one sample."""
        slave, period = self._slave, 1.0 / self._rate_hz
        measurements = np.asarray(y, dtype=np.float64)
        if measurements.shape != (len(self._y),):
            raise InputError(f"FmuController: measurements must be ({len(self._y)},), got {measurements.shape}.")
        try:
            (slave.setReal if self._old else slave.setFloat64)(self._y, measurements.tolist())
            slave.doStep(self._k / self._rate_hz, period)
            u = (slave.getReal if self._old else slave.getFloat64)(self._u)
        except Exception as error:
            raise self._failure(f"at sample {self._k}", error) from error
        self._k += 1
        return np.array(u)

    def _instance(self, model: Any, folder: str) -> Any:
        from fmpy import fmi2, fmi3

        log = self._said
        kind = fmi2.FMU2Slave if self._old else fmi3.FMU3Slave
        slave = kind(
            guid=model.guid if self._old else model.instantiationToken,
            unzipDirectory=folder,
            modelIdentifier=model.coSimulation.modelIdentifier,
            instanceName="controller",
        )
        try:
            if isinstance(slave, fmi3.FMU3Slave):
                slave.instantiate(logMessage=lambda _env, _status, _category, text: log.append(_text(text)))
            else:
                callbacks = fmi2.fmi2CallbackFunctions()
                callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda _c, _n, _s, _k, text: log.append(_text(text)))
                callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
                callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
                slave.instantiate(callbacks=callbacks)
        except Exception as error:
            raise self._failure("at its start", error) from error
        return slave

    def _failure(self, where: str, error: Exception) -> ToolError:
        words = f", its last words: '{self._said[-1]}'" if self._said else ""
        return ToolError(f"FmuController: '{self._path}' failed {where} ({_text(str(error)).rstrip('.')}){words}.")


def _text(words: Any) -> str:
    return " ".join((words.decode(errors="replace") if isinstance(words, bytes) else str(words)).split())
