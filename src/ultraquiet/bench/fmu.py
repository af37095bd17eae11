"""A plant from a functional mock-up unit (FMI 2.0 or 3.0, co-simulation), run through FMPy."""

import math
import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import BenchError, InputError, RunawayError, StorageError, ToolError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench.stepped import Setup, Stepped, SteppedPlant
from ultraquiet.values import Channel

REALS = ("Real", "Float64")  # what FMI 2.0 and 3.0 call a double


@register("bench", "fmu")
@dataclass(frozen=True)
class Fmu(Stepped):
    """A bench around an FMU for co-simulation, as Simulink, Dymola, OpenModelica and many others export it.

    At sample k its outputs are read, then its inputs are set to the command formed one sample before plus the
    disturbance of this sample, and it is stepped on to sample k + 1. Every run has an instance of its own. An FMU is
    foreign code in this process: one that crashes takes Python along; the bench `Process` is the safer way for it.

    Args:
        path: the FMU file.
        rate_hz: samples per second; what the FMU itself proposes as a step when absent.
        actuators, sensors: names of its real inputs and outputs in the order wanted; all of them when absent. Units
            and limits are those the FMU declares.
        parameters: name -> value of real parameters, set before every run.

    Raises:
        ToolError: FMPy is not installed.
        InputError: not a usable FMU, unknown variables, no rate.
        BenchError: the FMU refused a call, or its outputs are not finite.

    >>> Fmu("plant.fmu")
    Traceback (most recent call last):
    ultraquiet._base.errors.StorageError: Fmu: there is no file 'plant.fmu'.
    """

    path: str
    rate_hz: float | None = None
    actuators: tuple[Channel, ...] = ()
    sensors: tuple[Channel, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    _unpacked: "_Unpacked" = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        path = os.fspath(self.path)
        if not os.path.isfile(path):
            raise StorageError(f"Fmu: there is no file '{path}'.")
        unpacked = _Unpacked(path)
        put = object.__setattr__
        put(self, "path", path)
        put(self, "_unpacked", unpacked)
        put(self, "rate_hz", self._rate(unpacked.model))
        put(self, "actuators", tuple(_channel(v) for v in unpacked.chosen("input", self.actuators)))
        put(self, "sensors", tuple(_channel(v) for v in unpacked.chosen("output", self.sensors)))
        if self.parameters:
            unpacked.chosen("parameter", tuple(self.parameters))

    def _rate(self, model: Any) -> float:
        if self.rate_hz is not None:
            return positive("Fmu", "rate_hz", self.rate_hz, "Hz")
        proposed = getattr(model.defaultExperiment, "stepSize", None)
        if proposed is None:
            raise InputError(f"Fmu: '{self.path}' proposes no step, so 'rate_hz' must be given.")
        return 1.0 / positive("Fmu", "stepSize", proposed, "s")

    @property
    def provenance(self) -> Provenance:
        """Who measures: the file, the model's own identity and its parameters."""
        model = self._unpacked.model
        who = {"file": os.path.basename(self.path), "model": model.modelName, "guid": model.guid}
        return Provenance("bench.fmu", {**who, "rate_hz": self.rate_hz, "parameters": dict(self.parameters)})

    def _setup(self) -> Setup:
        assert self.rate_hz is not None
        return Setup("Fmu.run", _Instance(self, self.rate_hz), self.rate_hz, self.actuators, self.sensors)


class _Unpacked:
    """The description of an FMU and, once a run needs it, its unpacked files; they go when the bench goes."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._folder = ""
        fmpy = _fmpy()
        try:
            self.model = fmpy.read_model_description(path)
        except Exception as error:  # FMPy raises whatever its parser raises
            raise InputError(f"Fmu: '{path}' cannot be read as an FMU ({_described(error)}).") from error
        version = str(self.model.fmiVersion)
        if self.model.coSimulation is None or version[:2] not in ("2.", "3."):
            raise InputError(f"Fmu: '{path}' is no co-simulation FMU of FMI 2.0 or 3.0, but of FMI {version}.")

    @property
    def folder(self) -> str:
        """Where the files are."""
        if not self._folder:
            self._folder = tempfile.mkdtemp(prefix="ultraquiet-fmu-")
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
            _fmpy().extract(self._path, self._folder)
        return self._folder

    def chosen(self, causality: str, names: tuple[Channel | str, ...]) -> list[Any]:
        """Return the real scalar variables of a kind, all or those named."""
        kinds = (causality, "structuralParameter") if causality == "parameter" else (causality,)
        real = {
            v.name: v
            for v in self.model.modelVariables
            if v.causality in kinds and v.type in REALS and not (v.dimensions or v.dimensionValueReferences)
        }
        requested = [n.name if isinstance(n, Channel) else str(n) for n in names] or list(real)
        unknown = [name for name in requested if name not in real]
        if unknown or not requested:
            raise InputError(
                f"Fmu: '{self._path}' has no real {causality} '{unknown[0] if unknown else ''}'; "
                f"it has {', '.join(real) or 'none'}."
            )
        return [real[name] for name in requested]

    def __reduce__(self) -> Any:
        return _Unpacked, (self._path,)


class _Instance(SteppedPlant):
    """One instance of the FMU, for one run."""

    def __init__(self, bench: Fmu, rate_hz: float) -> None:
        self._bench, self._rate_hz = bench, rate_hz
        unpacked = bench._unpacked
        self._inputs = [v.valueReference for v in unpacked.chosen("input", bench.actuators)]
        self._outputs = [v.valueReference for v in unpacked.chosen("output", bench.sensors)]
        self._messages: list[str] = []
        self._slave: Any = None
        self._healthy = True

    def start(self, run_index: int) -> None:
        bench = self._bench
        try:
            self._slave = self._instantiated()
            if bench.parameters:
                names = tuple(bench.parameters)
                references = [v.valueReference for v in bench._unpacked.chosen("parameter", names)]
                self._set(references, [float(bench.parameters[name]) for name in names])
            if self._old:
                self._slave.setupExperiment(startTime=0.0)
                self._slave.enterInitializationMode()
            else:
                self._slave.enterInitializationMode(startTime=0.0)
            self._set(self._inputs, [0.0] * len(self._inputs))
            self._slave.exitInitializationMode()
        except Exception as error:
            raise self._failure("at the start of a run", error) from error

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        try:
            y = np.array(self._get(self._outputs))
            self._set(self._inputs, (u + d).tolist())
            self._slave.doStep(k / self._rate_hz, 1.0 / self._rate_hz)
        except Exception as error:
            raise self._failure(f"at sample {k}", error) from error
        if not np.isfinite(y).all():
            raise RunawayError(f"Fmu: at sample {k} the outputs must be finite, got {y.tolist()}.")
        return y

    def rest(self, error: BaseException | None) -> None:
        slave, self._slave = self._slave, None
        if slave is None:
            return
        try:
            if self._healthy:
                slave.terminate()
            slave.freeInstance()
        except Exception as failed:
            if error is None:
                raise self._failure("at the end of a run", failed) from failed

    @property
    def _old(self) -> bool:
        return str(self._bench._unpacked.model.fmiVersion).startswith("2.")

    def _instantiated(self) -> Any:
        from fmpy import fmi2, fmi3

        unpacked, messages = self._bench._unpacked, self._messages
        model = unpacked.model
        names = {
            "guid": model.guid if self._old else model.instantiationToken,
            "unzipDirectory": unpacked.folder,
            "modelIdentifier": model.coSimulation.modelIdentifier,
            "instanceName": "bench",
        }
        if not self._old:
            slave = fmi3.FMU3Slave(**names)
            slave.instantiate(logMessage=lambda _env, _status, _category, text: messages.append(_text(text)))
            return slave
        slave = fmi2.FMU2Slave(**names)
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda _c, _n, _s, _k, text: messages.append(_text(text)))
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        slave.instantiate(callbacks=callbacks)
        return slave

    def _set(self, references: list[int], values: list[float]) -> None:
        (self._slave.setReal if self._old else self._slave.setFloat64)(references, values)

    def _get(self, references: list[int]) -> list[float]:
        return (self._slave.getReal if self._old else self._slave.getFloat64)(references)

    def _failure(self, where: str, error: Exception) -> BenchError:
        self._healthy = False
        words = f", its last words: '{self._messages[-1]}'" if self._messages else ""
        return BenchError(f"Fmu: {where} the model failed ({_described(error)}){words}.")


def _channel(variable: Any) -> Channel:
    kind = variable.declaredType

    def declared(name: str, otherwise: float) -> float:
        declarations = [value for owner in (variable, kind) if (value := getattr(owner, name, None)) is not None]
        return float(declarations[0]) if declarations else otherwise

    unit = variable.unit or getattr(kind, "unit", None) or ""
    return Channel(variable.name, unit, declared("min", -math.inf), declared("max", math.inf))


def _fmpy() -> Any:
    try:
        import fmpy
    except ImportError as error:
        raise ToolError(f"Fmu: FMPy is missing ({error}); install it with 'pip install \"ultraquiet[fmu]\"'.") from None
    return fmpy


def _text(words: Any) -> str:
    return " ".join((words.decode(errors="replace") if isinstance(words, bytes) else str(words)).split())


def _described(error: Exception) -> str:
    return _text(str(error)).rstrip(".") or type(error).__name__
