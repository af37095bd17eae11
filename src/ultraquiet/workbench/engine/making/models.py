"""A model from records, and what it is worth on those it has not seen."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet import validate
from ultraquiet._base.errors import InputError
from ultraquiet.identify.result import Result
from ultraquiet.pipeline import identification
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import PlantFacts, RecordPlant
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.making.designs import plant_key
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.study import Plant
from ultraquiet.values import Record, StateSpace
from ultraquiet.workbench.engine.making.made import Made

LAGS = 25
POLYNOMIAL, PLANT_STAGE = "polynomial", "plant"


def plant_table(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """Return `[plant]` of a study for a model on the boards: groups of records, a period, a method, further units."""
    groups = identification.grouped(recipe["records"])
    # one record of a group stands for itself: its group's name would mean all of them
    names = [name if len(members) > 1 else members[0] for name, members in groups.items()]
    period = {} if recipe.get("period_samples") is None else {"period_samples": recipe["period_samples"]}
    units = {"units": list(recipe["units"])} if recipe.get("units") else {}
    return {**recipe["method"], "records": names, **period, **units}


def identified(
    records: Mapping[str, Record],
    recipe: Mapping[str, Any],
    stages: Cache | None = None,
    hashes: Mapping[str, str] | None = None,
) -> Made:
    """Identify a model, as the stage `plant` of a study does.

    Args:
        records: by name, those that the recipe names.
        recipe: how.
        stages: of the study, from which the outcome is read where it is there, and where it is left for a run.
        hashes: of all records of the study; of these alone when absent.

    Raises:
        InputError: the method refuses the records or its settings.
    """
    settings = Plant.model_validate(plant_table(recipe))
    key = plant_key(hashes or {name: record.hash for name, record in records.items()}, settings)
    if stages is not None and stages.holds(PLANT_STAGE, key):
        outcome = stages.stage(PLANT_STAGE, "models", key, lambda: identification.plant(records, settings), PlantFacts)
        evidence, values = {}, {k: v for k, v in outcome.values.items() if k == stored.RESPONSE}
    else:
        outcome, evidence, values = _outcome(records, settings)
        if stages is not None:
            stages.stage(PLANT_STAGE, "models", key, lambda: outcome, PlantFacts)
    model: StateSpace = outcome.values[stored.PLANT]
    poles = model.poles()
    facts = {
        **evidence,
        "plant": to_plain(outcome.facts),
        "status": outcome.facts.status,
        "states": model.states,
        "rate_hz": model.rate_hz,
        "actuators": [[c.name, c.unit] for c in model.actuators],
        "sensors": [[c.name, c.unit] for c in model.sensors],
        "poles": [[float(p.real), float(p.imag)] for p in poles],
        "hash": model.hash,
    }
    return Made(facts, {"value": model, **values})


def _outcome(records: Mapping[str, Record], settings: Plant) -> tuple[Outcome[Any], dict[str, Any], dict[str, Any]]:
    """Return what the stage `plant` leaves, with what it does not keep: evidence, and the model with its noise."""
    if settings.period_samples is not None or len(records) > 1:
        outcome = identification.plant(records, settings)
        return outcome, {}, {key: value for key, value in outcome.values.items() if key == stored.RESPONSE}
    (record,) = records.values()
    result = settings.make("identify").identify(record)
    if not isinstance(result, Result):
        raise InputError(f"identify: '{settings.method}' gives no model of a whole bench; choose another method.")
    system = result.state_space()
    facts = RecordPlant(status=str(result.status), fit_percent=result.fit_percent, states=system.states)
    evidence = {
        "ok": result.status.ok,
        "loss": result.loss.tolist(),
        "whiteness_p": result.whiteness_p.tolist(),
        "correlation_p": result.correlation_p.tolist(),
        "statuses": [str(status) for status in result.statuses],
    }
    polynomial = {} if isinstance(result.model, StateSpace) else {POLYNOMIAL: result.model}
    return Outcome({stored.PLANT: system}, facts), evidence, polynomial


def judged(model: StateSpace, record: Record) -> dict[str, Any]:
    """Return what a model is worth on a record: fit, and whether residuals are white and free of the inputs.

    Raises:
        InputError: model and record do not fit together; the sentence names both.
    """
    ny, nu = model.D.shape
    if (len(record.actuators), len(record.sensors)) != (nu, ny):
        raise InputError(
            f"validate: the model has {nu} inputs and {ny} outputs, the record "
            f"{len(record.actuators)} and {len(record.sensors)}; choose a record of the same bench."
        )
    compared = validate.compare(model, record)
    said = validate.simulated(model, record)
    residuals = record.outputs - said
    return {
        "fit_percent": compared.fit_percent.tolist(),
        "residual": _correlations(residuals, record.inputs),
        "simulated": said,
        "residuals": residuals,
    }


def _correlations(residuals: Any, inputs: Any) -> dict[str, Any]:
    """Return autocorrelation of each residual and its largest correlation with any input, by lag."""
    n = residuals.shape[1]
    lags = min(LAGS, n - 1)
    e = _unit(residuals)
    u = _unit(inputs)
    own = [[float(np.sum(row[k:] * row[: n - k])) for k in range(lags + 1)] for row in e]
    cross = [[max(abs(float(np.sum(row[k:] * x[: n - k]))) for x in u) for k in range(lags + 1)] for row in e]
    return {"auto": own, "cross": cross, "bound": 2.58 / float(np.sqrt(n)), "lags": lags}


def _unit(signals: Any) -> Any:
    centred = signals - signals.mean(axis=1, keepdims=True)
    size = np.sqrt(np.sum(centred**2, axis=1, keepdims=True))
    return np.divide(centred, size, out=np.zeros_like(centred), where=size > 0)
