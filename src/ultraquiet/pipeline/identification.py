"""The stages that turn records into models: channel by channel as the paper did, and whole for design."""

import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from ultraquiet import identify, spectra
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.progress import task
from ultraquiet._base.registry import lookup
from ultraquiet.identify.successive_orders import frequency_and_damping
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import (
    IdentificationFacts,
    JudgedPlant,
    PaperFit,
    PlantFacts,
    PreferredModels,
    RankedModel,
    RecordPlant,
    ResponsePlant,
    WeightedPlant,
)
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import IdentifyTable, Paper, Plant
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, Record, StateSpace

READY_SAMPLES = 600


def grouped(names: Collection[str]) -> dict[str, list[str]]:
    """Return the names of records by their groups: NAME-1, NAME-2, ... in this order, or NAME alone.

    >>> grouped(["step", "noise-1", "noise-10", "noise-2", "run-a"])
    {'step': ['step'], 'noise': ['noise-1', 'noise-2', 'noise-10'], 'run-a': ['run-a']}
    """
    known = set(names)
    groups: dict[str, list[tuple[int, str]]] = {}
    for name in names:
        stem, _, number = name.rpartition("-")
        one_of_many = number.isdecimal() and f"{stem}-1" in known
        groups.setdefault(stem if one_of_many else name, []).append((int(number) if one_of_many else 0, name))
    return {stem: [name for _, name in sorted(members)] for stem, members in groups.items()}


def group(records: Mapping[str, Record], name: str) -> list[Record]:
    """Return the records of a group in the actuators' order: NAME-1, NAME-2, ..., or NAME alone."""
    if name in records:
        return [records[name]]
    groups = grouped(records)
    if name not in groups:
        known = sorted(groups)
        raise InputError(f"study: there are no records '{name}'; the experiment leaves {', '.join(known)}.")
    return [records[key] for key in groups[name]]


def sweep_groups(records: Mapping[str, Record], settings: IdentifyTable) -> tuple[str | None, str | None]:
    """Return the groups of records to fit and to judge by; None where there is none that will do.

    A group does when it drives one actuator after the other, each alone, one record an actuator; what is held out is
    fitted by none.
    """
    able = [name for name in grouped(records) if _one_by_one(group(records, name))]
    fitted = settings.records or next((name for name in able if name != settings.held_out), None)
    judged = settings.held_out or next((name for name in able if name != fitted), None)
    return fitted, judged


def _one_by_one(members: list[Record]) -> bool:
    moving = [np.flatnonzero(np.ptp(record.inputs, axis=1) > 0) for record in members]
    return len(members) == len(members[0].actuators) and all(m.tolist() == [k] for k, m in enumerate(moving))


def identified(
    records: Mapping[str, Record], settings: IdentifyTable, paper: Paper | None = None
) -> Outcome[IdentificationFacts]:
    """Rank structures and orders on held-out records, and fit the paper's structure to each of its test signals.

    Records in which actuators move together only are left to the model of the whole plant: nothing is ranked then.
    """
    fitted, judged = sweep_groups(records, settings)
    if fitted is None:
        return Outcome({}, IdentificationFacts(table=(), preferred=None, paper={}))
    driven = group(records, fitted)
    ranking = identify.sweep(
        driven,
        None if judged is None else group(records, judged),
        structures=settings.structures,
        orders=settings.orders,
    )
    best = ranking.preferred.method
    matrix, methods, words = ranking.by_channel()
    actuators = [record.actuators[k if len(record.actuators) > 1 else 0] for k, record in enumerate(driven)]
    values: dict[str, PolynomialMatrix] = {
        stored.PREFERRED: PolynomialMatrix(matrix.rows, actuators, driven[0].sensors)
    }
    fits: dict[str, PaperFit] = {}
    if paper is not None:
        structure = lookup("identify", paper.structure)(order=paper.order)
        for name in paper.records:
            ranked = ranking.of(structure) if name == fitted else None
            if ranked is None:
                started = time.perf_counter()
                result = identify.identify_matrix(structure, group(records, name))
                seconds = time.perf_counter() - started
            else:
                result, seconds = ranking.result(ranked), ranked.seconds
            values[stored.paper(name)], fits[name] = result.model, _paper_fit(result, seconds)
    preferred = PreferredModels(
        structure=best.name,
        order=best.whole_order,
        by_channel=tuple(tuple(f"{m.name} {m.whole_order}" for m in row) for row in methods),
        verdicts={word: words.count(word) for word in dict.fromkeys(words)},
    )
    table = tuple(RankedModel(**row) for row in ranking.table())
    return Outcome(values, IdentificationFacts(table=table, preferred=preferred, paper=fits))


def prepare(settings: IdentifyTable) -> None:
    """Compile, or load, what the sweep of a study will use: it is made once of a few samples, which compile alike."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((1, READY_SAMPLES))
    record = Record(u, np.roll(u, 1) + 0.1 * rng.standard_normal(u.shape), 1.0)
    with suppress(UltraquietError):
        identify.sweep([record], structures=settings.structures, orders=[min(settings.orders)], workers=1)


def _paper_fit(result: identify.MatrixResult, seconds: float) -> PaperFit:
    return PaperFit(
        median_fit_percent=float(np.median(result.fit_percent)),
        worst_fit_percent=float(np.min(result.fit_percent)),
        status=str(result.status),
        ok=sum(s.ok for row in result.statuses for s in row),
        stable=result.model.is_stable(),
        invertible=result.model.is_invertible(),
        seconds=seconds,
    )


def plant(records: Mapping[str, Record], settings: Plant) -> Outcome[PlantFacts]:
    """Identify the model that controllers are designed from."""
    method = settings.make("identify")
    if settings.period_samples is None:
        taken = recorded(settings.records, grouped(records))
        if len(taken) > 1:
            raise InputError(f"plant: {one_record_of(taken)}")
        result = method.identify(group(records, settings.records[0])[0])
        system = result.state_space()
        facts = RecordPlant(status=str(result.status), fit_percent=result.fit_percent, states=system.states)
        return Outcome({stored.PLANT: system}, facts)
    if not hasattr(method, "identify_response"):
        raise InputError(f"plant: '{settings.method}' does not fit responses; leave 'period_samples' out.")
    response = measured_response(records, settings)
    rate_hz = group(records, settings.records[0])[0].rate_hz
    fit = method.identify_response(response, rate_hz)
    return Outcome({stored.PLANT: fit.model, stored.RESPONSE: response}, _of_response(method, fit, rate_hz))


def _of_response(method: Any, fit: Any, rate_hz: float) -> PlantFacts:
    """Return what a fit of a response says of itself; its numbers by order are another thing with each method."""
    status, states = str(fit.status), fit.model.states
    if isinstance(fit, identify.ResponseFit):
        return ResponsePlant(
            status=status,
            states=states,
            order=fit.order,
            held_out_error=fit.error[1],
            errors_by_order=fit.errors_by_order,
            modes_by_order={n: frequency_and_damping(poles, rate_hz) for n, poles in fit.poles_by_order.items()},
        )
    if isinstance(fit, identify.WeightedFit):
        return WeightedPlant(
            status=status,
            states=states,
            order=fit.order,
            misfit_in_noise=fit.error[1],
            criterion=method.criterion,
            criterion_by_order=fit.errors_by_order,
        )
    return JudgedPlant(status=status, states=states)


def recorded(names: Sequence[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the records that names stand for: those of a group, or the one that is called so."""
    return [member for name in names for member in groups.get(name, [name])]


def one_record_of(names: Sequence[str]) -> str:
    """Return what would do where several records are named and one model is to come from one of them."""
    return (
        f"these are {len(names)} records ({', '.join(names[:3])}{', ...' if len(names) > 3 else ''}), and without "
        "'period_samples' the plant is identified from one in which all actuators move: name a record of "
        'actuator = "all", or excite with a periodic signal, give its \'period_samples\' and method = "rational".'
    )


def measured_response(records: Mapping[str, Record], settings: Plant) -> FrequencyResponse:
    """Return the responses of all groups of periodic records, side by side in frequency."""
    assert settings.period_samples is not None
    parts = [spectra.periodic_response(group(records, name), settings.period_samples) for name in settings.records]
    f = np.concatenate([p.f_hz for p in parts])
    if np.unique(f).size < f.size:
        raise InputError("plant: two groups of periodic records share lines; give them bands of their own.")
    order = np.argsort(f)
    variances = [p.variance for p in parts if p.variance is not None]
    return FrequencyResponse(
        f[order],
        np.concatenate([p.values for p in parts], axis=2)[:, :, order],
        estimator="; ".join(p.estimator for p in parts),
        actuators=parts[0].actuators,
        sensors=parts[0].sensors,
        provenance=parts[0].provenance,
        variance=np.concatenate(variances, axis=2)[:, :, order],
    )


def further(bench: Any, unit: str, records: Mapping[str, Record], settings: Plant) -> Outcome[PlantFacts]:
    """Record the groups that the plant is identified from on another unit's bench, and identify it likewise.

    Args:
        bench: of the other unit.
        unit: its name, under which the model is kept.
        records: of the study's own unit; their inputs are what is sent.
        settings: `[plant]`.
    """
    groups = grouped(records)
    names = [name for asked in settings.records for name in groups.get(asked, [asked])]
    again: dict[str, Record] = {}
    with task(f"record {unit}", len(names)) as progress:
        for name in names:
            again[name] = bench.run(records[name].inputs)
            progress.advance(note=name)
    found = plant(again, settings)
    return Outcome({of_unit(unit): found.values[stored.PLANT]}, found.facts)


def of_unit(unit: str) -> str:
    """Return the name under which the model of a further unit is kept."""
    return f"{stored.PLANT}-{unit}"


def for_method(method: Any, first: StateSpace, others: Mapping[str, StateSpace]) -> Any:
    """Return what a design is given: all plants where it takes several, else the first."""
    if not others or not getattr(method, "several_plants", False):
        return first
    return [first, *others.values()]
