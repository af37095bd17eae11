"""One object of every class that the package exports, made as a caller would make it, on the smallest of problems."""

import contextlib
import dataclasses
import inspect
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet import values
from ultraquiet._base import registry
from ultraquiet.testing import problems

PLANT = Path(__file__).parents[2] / "docs" / "examples" / "plant.py"
ROOMS = [*(name for name in uq.__all__ if inspect.ismodule(getattr(uq, name)) and name != "errors"), "values"]


def exported() -> dict[str, type]:
    """Every class behind a public name, without protocols, errors, enumerations and what nobody can make."""
    found = {}
    for room in ROOMS:
        door = values if room == "values" else getattr(uq, room)
        for name in door.__all__:
            kind = getattr(door, name)
            if not inspect.isclass(kind) or issubclass(kind, BaseException | values.StatusWord):
                continue
            if not getattr(kind, "_is_protocol", False) and not inspect.isabstract(kind):
                found[f"{room}.{name}"] = kind
    return found


def reachable(roots) -> dict[type, object]:
    """The first object of each class that the roots hold, at any depth."""
    found, waiting, seen = {}, list(roots), set()
    while waiting:
        one = waiting.pop(0)
        if id(one) in seen or len(seen) > 20000:
            continue
        seen.add(id(one))
        if type(one).__module__.startswith("ultraquiet"):
            found.setdefault(type(one), one)
            held = getattr(one, "__dict__", {})
            waiting.extend(held.values())
        if isinstance(one, Mapping):
            waiting.extend(one.values())
        elif isinstance(one, list | tuple):
            waiting.extend(one[:50])
    return found


def settings():
    """Every registered method as it is without a setting."""
    for family in registry.FAMILIES:
        for kind in registry.methods(family).values():
            with contextlib.suppress(TypeError, uq.errors.InputError):
                yield kind()


def two_channels(seed: int = 1, samples: int = 1500):
    """A plant of two channels with units of its own, a law for it, and a record of it."""
    plant = problems.damped_plant(seed)
    wires = (
        [uq.Channel("push x", "N", -9, 9), uq.Channel("push y", "N")],
        [uq.Channel("x", "m/s"), uq.Channel("y", "m/s")],
    )
    plant = uq.StateSpace(plant.A, plant.B, plant.C, plant.D, plant.rate_hz, *wires)
    u = np.random.default_rng(seed).standard_normal((2, samples))
    y = plant.simulate(u)
    record = uq.Record(u, y + 0.01 * np.random.default_rng(seed + 1).standard_normal(y.shape), plant.rate_hz, *wires)
    return plant, record


def examples(folder: Path):
    """Objects whose classes, with those that they hold, are what most callers meet."""
    plant, record = two_channels()
    law = uq.design.Lqg().design(plant)
    K = law.controller
    yield from (plant, record, law, *settings())
    yield from of_values(plant, record)
    yield from of_analysis(plant, K)
    yield from of_identification(record)
    yield from of_spectra(record)
    yield from of_benches(plant, record, K)
    yield from of_code(plant, K, folder)
    yield from of_files(record, folder)


def of_values(plant, record):
    yield uq.FrequencyResponse([1.0, 2.0, 3.0], plant.frequency_response([1.0, 2.0, 3.0]))
    yield uq.InnovationForm([[0.5]], [[0.5]], [[1.0]], [[0.0]], [[0.2]], [[1.0]], rate_hz=1.0)
    yield values.SteppedController(plant)
    yield values.Decimation(4)
    yield uq.plot.figure(record)
    yield values.Blending(np.eye(2), np.eye(2), record.sensors, record.actuators)


def of_analysis(plant, K):
    yield uq.analyse.disk_margins(plant, K)
    yield uq.analyse.end_margins(plant, K)
    yield uq.analyse.loop_margins(plant, K)
    yield uq.analyse.gang_of_six(plant, K)
    yield uq.analyse.peak_gain(plant)
    yield uq.analyse.poles(plant)
    yield uq.analyse.monte_carlo([plant], K, band_hz=(10.0, 50.0))
    block = uq.analyse.PerturbationBlock(1, 1)
    yield from (block, uq.analyse.mu_bounds(plant.frequency_response([5.0, 20.0]), [1, 1]))
    yield uq.limits.bode_integral(plant, K)
    ok, f_hz = values.Status("ok", "Made for a picture."), np.geomspace(1.0, 400.0, 30)
    yield uq.limits.Limit(ok, 20.0, 21.0, 6.0, f_hz=f_hz, sensitivity=np.linspace(0.1, 2.0, 30))
    yield uq.reduce.Balanced(states=4).reduce(K, plant)


def of_identification(record):
    one, arx = record.pick([0], [0]), uq.identify.Arx(order=3)
    found = arx.identify(one)
    yield from (found, uq.identify.identify_matrix(arx, [record.pick([0]), record.pick([1])]))
    yield uq.identify.sweep([one], structures=("arx",), orders=(2, 3), workers=1)
    yield uq.identify.channel_health([record])
    yield uq.identify.RegularisedArx(lags=20).identify(one)
    yield uq.validate.residual_test(found.model, one)
    yield uq.validate.response_band(found, [5.0, 20.0, 80.0])
    yield uq.validate.compare(found.model, one)
    yield uq.validate.bode_agreement(found.model, found.model, (5.0, 200.0))
    yield uq.validate.select({"arx": found}, one)
    yield uq.validate.from_spread(found.model, [found.model], [5.0, 20.0, 80.0])
    other = found.model.state_space()
    spread = uq.validate.from_spread(other, [0.9 * other], np.geomspace(2.0, 200.0, 20))
    yield from (spread, spread.weight(record.rate_hz))


def of_spectra(record):
    density = uq.spectra.psd(record, segment_samples=256)
    yield from (density, uq.spectra.frf(record, segment_samples=256))
    yield uq.spectra.cross_spectra(record, segment_samples=256)
    yield uq.spectra.coherence(record, segment_samples=256)
    levels = uq.spectra.band_levels(density, start_hz=40.0, stop_hz=200.0)
    yield from (levels, uq.spectra.CRITERIA[0])
    yield uq.spectra.transmissibility(record, ["x"], ["y"], segment_samples=256)
    yield uq.spectra.local_polynomial(record.part(0, 400))


def of_benches(plant, record, K):
    bench = uq.bench.LinearBench(plant)
    channels = [uq.Channel("force", "N", -5.0, 5.0)], [uq.Channel("speed", "m/s", -9.0, 9.0)]
    yield from (bench, uq.bench.Replay((record,)))
    yield uq.bench.Wrapped(lambda u, d: 2.0 * (u + d), lambda: None, 100.0, *channels)
    yield uq.bench.Hardware(lambda u: None, lambda: np.zeros(1), 100.0, *channels)
    with contextlib.closing(uq.bench.Process(command=(sys.executable, str(PLANT)))) as process:
        yield process
    yield next(iter(bench.stream(np.zeros((2, 10)))))
    yield uq.simulate.attenuation(bench, K, tones_hz=(20.0, 40.0), duration_s=0.5)
    yield uq.simulate.noise_reduction(bench, K, (10.0, 50.0), duration_s=0.5)
    yield uq.simulate.step_reduction(bench, K, duration_s=0.5)
    yield uq.simulate.OpenLoop(bench)
    yield uq.bench.Decimated(bench, values.Decimation(4))
    yield uq.bench.Blended(bench, values.Blending(np.eye(2), np.eye(2), bench.sensors, bench.actuators))
    S = uq.FrequencyResponse([5.0, 20.0, 80.0], 0.5 * np.ones((1, 1, 3)))
    yield uq.simulate.MeasuredSensitivity(S, S.values, S.values, np.full(3, 0.01))


def of_code(plant, K, folder):
    code = uq.deploy.generate(K, folder / "code")
    yield from (code, uq.deploy.Frame(), uq.deploy.Frame().simulate(code, frames=200))
    yield uq.deploy.reanalysis(K, K, plant, [20.0, 40.0])
    yield uq.deploy.on_bench(uq.bench.LinearBench(plant), K, values.SteppedController(K), (20.0, 40.0), duration_s=0.5)
    yield uq.deploy.fixed_law(K, word="q31", input_v=10.0, output_v=10.0)


def of_files(record, folder):
    uq.files.export_record(record, folder / "run.csv")
    yield uq.files.survey(folder / "run.csv")


FABRIC = {
    "complex128": np.exp(1j * np.linspace(0.1, 3.0, 24)).reshape(1, 2, 12),
    "float64": np.linspace(0.1, 3.0, 24).reshape(2, 12),
    "ndarray": np.arange(12),
    "FrequencyResponse": uq.FrequencyResponse(np.arange(1.0, 13.0), np.ones((1, 2, 12))),
    "Channel": (uq.Channel("force", "N", -5.0, 5.0),),
    "Bench": uq.bench.LinearBench(problems.damped_plant(1)),
    "tuple[str": ("one", "two"),
    "tuple[float": (5.0, 25.0),
    "tuple[": (),
    "Mapping": {},
    "Path": Path("somewhere"),
    "StateSpace": problems.damped_plant(1),
    "Status": values.Status("fragile", "Made for a picture."),
    "bool": True,
    "float": 0.25,
    "int": 3,
    "str": "a name",
}


def fabricated(kind):
    """An object with fields of the right kind and nothing computed: what it shows must hold for any content."""
    if issubclass(kind, tuple):
        return kind(*[0.25] * len(kind._fields))
    made = object.__new__(kind)
    for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
        said = str(field.type)
        value = next((content for word, content in FABRIC.items() if word in said), None)
        if field.name.endswith("f_hz") and "ndarray" in said:
            value = np.linspace(1.0, 12.0, 12)
        object.__setattr__(made, field.name, value)
    return made


def every_object(folder: Path | None = None) -> tuple[dict[str, object], list[str]]:
    """One object of every exported class by its name, and the names of those that were only fabricated."""
    with contextlib.ExitStack() as stack:
        place = folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        found = reachable(list(examples(place)))
    kinds = exported()
    bare = [name for name, kind in kinds.items() if kind not in found]
    return {name: found[kind] if kind in found else fabricated(kind) for name, kind in kinds.items()}, bare
