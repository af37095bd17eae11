"""The stages that turn records into models: channel by channel as the paper did, and whole for design."""

import time
from collections.abc import Mapping

import numpy as np

from ultraquiet import identify, spectra
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import (
    IdentificationFacts,
    PaperFit,
    PlantFacts,
    PreferredModels,
    RankedModel,
    RecordPlant,
    ResponsePlant,
)
from ultraquiet.pipeline.study import IdentifyTable, Plant
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, Record


def group(records: Mapping[str, Record], name: str) -> list[Record]:
    """Return the records of a group in the actuators' order: NAME-1, NAME-2, ..., or NAME alone."""
    if name in records:
        return [records[name]]
    members = [key for key in records if key.rpartition("-")[0] == name]
    if not members:
        known = sorted({key.rpartition("-")[0] or key for key in records})
        raise InputError(f"study: there are no records '{name}'; the experiment leaves {', '.join(known)}.")
    return [records[key] for key in sorted(members, key=lambda k: int(k.rpartition("-")[2]))]


def identified(records: Mapping[str, Record], settings: IdentifyTable) -> Outcome[IdentificationFacts]:
    """Rank structures and orders on held-out records, and fit the paper's structure to each of its test signals."""
    ranking = identify.sweep(
        group(records, settings.records),
        group(records, settings.held_out),
        structures=settings.structures,
        orders=settings.orders,
    )
    best = ranking.preferred.method
    matrix, methods, words = ranking.by_channel()
    driven = group(records, settings.records)
    actuators = [record.actuators[k] for k, record in enumerate(driven)]
    values: dict[str, PolynomialMatrix] = {
        stored.PREFERRED: PolynomialMatrix(matrix.rows, actuators, driven[0].sensors)
    }
    paper = lookup("identify", settings.paper_structure)(order=settings.paper_order)
    fits: dict[str, PaperFit] = {}
    for name in settings.paper_records:
        ranked = ranking.of(paper) if name == settings.records else None
        if ranked is None:
            started = time.perf_counter()
            result = identify.identify_matrix(paper, group(records, name))
            seconds = time.perf_counter() - started
        else:
            result, seconds = ranking.result(ranked), ranked.seconds
        values[stored.paper(name)], fits[name] = result.model, _paper_fit(result, seconds)
    preferred = PreferredModels(
        structure=best.name,
        order=best.order,
        by_channel=tuple(tuple(f"{m.name} {m.order}" for m in row) for row in methods),
        verdicts={word: words.count(word) for word in dict.fromkeys(words)},
    )
    table = tuple(RankedModel(**row) for row in ranking.table())
    return Outcome(IdentificationFacts(table=table, preferred=preferred, paper=fits), values)


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
        if len(settings.records) > 1 or len(group(records, settings.records[0])) > 1:
            raise InputError("plant: without 'period_samples' one record that excites all actuators is needed.")
        result = method.identify(group(records, settings.records[0])[0])
        system = result.state_space()
        facts = RecordPlant(status=str(result.status), fit_percent=result.fit_percent, states=system.states)
        return Outcome(facts, {stored.PLANT: system})
    if not hasattr(method, "identify_response"):
        raise InputError(f"plant: '{settings.method}' does not fit responses; leave 'period_samples' out.")
    response = measured_response(records, settings)
    rate_hz = group(records, settings.records[0])[0].rate_hz
    fit = method.identify_response(response, rate_hz)
    facts = ResponsePlant(
        status=str(fit.status),
        states=fit.model.states,
        order=fit.order,
        held_out_error=fit.error[1],
        errors_by_order=fit.errors_by_order,
    )
    return Outcome(facts, {stored.PLANT: fit.model, stored.RESPONSE: response})


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
