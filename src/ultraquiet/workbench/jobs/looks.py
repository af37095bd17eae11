"""What is computed only to be looked at: arrays, kept beside the items by what they depend on."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import spectra
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.tables import Method
from ultraquiet.identify.result import Result
from ultraquiet.identify.successive_orders import frequency_and_damping, poles_by_order
from ultraquiet.pipeline.facts.limits import DesignLimit
from ultraquiet.pipeline.limits import beside_its_limit
from ultraquiet.validate import compare, response_band
from ultraquiet.values import Record, StateSpace
from ultraquiet.workbench.engine.items import FOLDER, key_of
from ultraquiet.workbench.engine.making import models, work
from ultraquiet.workbench.figures.traces import envelope

VIEWS = "views"
HELD_OUT = 0.4
COLUMNS = 1200

Look = Callable[[Path, dict[str, Any]], dict[str, Any]]


def seen(folder: Path, name: str) -> dict[str, Any]:
    """Return the arrays of a look by its name."""
    with np.load(folder / FOLDER / VIEWS / f"{name}.npz", allow_pickle=False) as found:
        return {key: found[key] for key in found.files}


def _kept(folder: Path, key: Any, compute: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """Return the name of a look, computed unless it is there."""
    name = content_hash(key)[:24]
    path = folder / FOLDER / VIEWS / f"{name}.npz"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        part = path.with_name(f".{name}.part.npz")
        np.savez(part, **compute())
        part.replace(path)
    return {"view": name}


def trace(folder: Path, state: dict[str, Any], name: str, start_s: float = 0.0, stop_s: float = -1.0) -> dict[str, Any]:
    """Look at a record over time, between two instants, at one column of pixels a bin."""

    def compute() -> dict[str, Any]:
        record: Record = work.make(folder, state, "data", name).value()
        stop = record.samples if stop_s < 0 else min(record.samples, int(stop_s * record.rate_hz))
        start = min(max(0, int(start_s * record.rate_hz)), stop - 1)
        signals = np.vstack([record.inputs, record.outputs])[:, start:stop]
        places, shown = envelope(signals, COLUMNS)
        return {"time_s": (places + start) / record.rate_hz, "signals": shown}

    return _kept(folder, ["trace", key_of(state, "data", name), start_s, stop_s], compute)


def response(folder: Path, state: dict[str, Any], names: list[str], settings: dict[str, Any]) -> dict[str, Any]:
    """Look at the measured response of records, with coherence and variance."""

    def compute() -> dict[str, Any]:
        records = [work.make(folder, state, "data", name).value() for name in names]
        found = spectra.frf(records if len(records) > 1 else records[0], **settings)
        assert found.coherence is not None
        assert found.variance is not None
        by_name = [c.name for c in records[0].actuators]
        inputs = [by_name.index(c.name) if c.name in by_name else k for k, c in enumerate(found.actuators)]
        return {
            "f_hz": found.f_hz,
            "values": found.values,
            "coherence": found.coherence,
            "variance": found.variance,
            "inputs": np.array(inputs),
            "words": np.array(found.estimator),
        }

    return _kept(folder, ["response", [key_of(state, "data", name) for name in names], settings], compute)


def density(folder: Path, state: dict[str, Any], name: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Look at the amplitude spectral density of every channel of a record, and its cumulative RMS."""

    def compute() -> dict[str, Any]:
        record: Record = work.make(folder, state, "data", name).value()
        found = spectra.psd(record, **settings)
        step = np.gradient(found.f_hz)
        return {
            "f_hz": found.f_hz,
            "asd": np.sqrt(found.values),
            "rms": np.sqrt(np.cumsum(found.values * step, axis=1)),
            "words": np.array(found.estimator),
        }

    return _kept(folder, ["density", key_of(state, "data", name), settings], compute)


def judge(folder: Path, state: dict[str, Any], model: str, data: str) -> dict[str, Any]:
    """Look at what a model says to a record: simulation, residuals, fit."""

    def compute() -> dict[str, Any]:
        system: StateSpace = work.make(folder, state, "models", model).value()
        record: Record = work.make(folder, state, "data", data).value()
        found = models.judged(system, record)
        places, shown = envelope(np.vstack([record.outputs, found["simulated"]]), COLUMNS)
        ny = len(record.sensors)
        residual = found["residual"]
        return {
            "fit_percent": np.array(found["fit_percent"]),
            "time_s": places / record.rate_hz,
            "measured": shown[:ny],
            "simulated": shown[ny:],
            "auto": np.array(residual["auto"]),
            "cross": np.array(residual["cross"]),
            "bound": np.array(residual["bound"]),
        }

    kept = _kept(folder, ["judge", key_of(state, "models", model), key_of(state, "data", data)], compute)
    return {**kept, "fit_percent": seen(folder, kept["view"])["fit_percent"].tolist()}


def confidence(folder: Path, state: dict[str, Any], model: str) -> dict[str, Any]:
    """Look at the 95 % band of a model's response, where its method states a covariance."""

    def compute() -> dict[str, Any]:
        recipe = state["models"][model]
        (name,) = recipe["records"]
        record: Record = work.make(folder, state, "data", name).value()
        settings = Method.model_validate(recipe["method"]).make("identify")
        result = settings.identify(record)
        if not isinstance(result, Result):
            raise InputError(f"identify: '{recipe['method']['method']}' states no covariance.")
        f_hz = np.geomspace(record.rate_hz / record.samples, 0.49 * record.rate_hz, 200)
        band = response_band(result, f_hz)
        return {"f_hz": f_hz, "low_db": band.gain_low_db, "high_db": band.gain_high_db}

    return _kept(folder, ["confidence", key_of(state, "models", model)], compute)


def modes(folder: Path, state: dict[str, Any], data: str) -> dict[str, Any]:
    """Look at the poles of a record, one order after the other."""

    def compute() -> dict[str, Any]:
        record: Record = work.make(folder, state, "data", data).value()
        roots = {n: frequency_and_damping(p, record.rate_hz) for n, p in poles_by_order(record).items()}
        rows = [(n, *row) for n, found in roots.items() for row in found]
        return {"rows": np.array(rows).reshape(-1, 3), "orders": np.array(list(roots)), "rate_hz": record.rate_hz}

    return _kept(folder, ["modes", key_of(state, "data", data)], compute)


def limit(folder: Path, state: dict[str, Any], law: str) -> dict[str, Any]:
    """Look at a law beside what any could do over its band at its price; without a bound the limit is NaN."""

    def compute() -> dict[str, Any]:
        made = work.make(folder, state, "laws", law)
        plant: StateSpace = work.make(folder, state, "models", made.recipe["model"]).value()
        found = beside_its_limit(plant, made.value(), tuple(made.facts["band_hz"]))
        figures = (found.attenuation_db, found.limit_db) if isinstance(found, DesignLimit) else (np.nan, np.nan)
        return {"attenuation_db": figures[0], "limit_db": figures[1], "words": np.array(found.status)}

    return _kept(folder, ["limit", key_of(state, "laws", law)], compute)


def orders(folder: Path, state: dict[str, Any], data: str, method: dict[str, Any], tried: list[int]) -> dict[str, Any]:
    """Look at what each order is worth on the end of a record, which the models have not seen."""
    rows: list[dict[str, Any]] = []
    record: Record = work.make(folder, state, "data", data).value()
    cut = int((1 - HELD_OUT) * record.samples)
    with task(f"orders of {method['method']}", len(tried)) as progress:
        for order in tried:
            row: dict[str, Any] = {"order": order}
            try:
                settings = Method.model_validate({**method, "order": order}).make("identify")
                result = settings.identify(record.part(0, cut))
                unseen = compare(result.model, record.part(cut)).fit_percent
                row |= {"seen": float(np.median(result.fit_percent)), "unseen": float(np.median(unseen))}
                row |= {"states": result.state_space().states, "status": str(result.status)}
                row["stable"] = result.state_space().is_stable()
            except UltraquietError as error:
                row["refused"] = str(error)
            rows.append(row)
            progress.advance(note=f"order {order}")
    return {"rows": rows}
