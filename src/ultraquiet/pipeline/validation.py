"""The stages that judge models: the paper's validation, and what the transfer matrix looks like."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet import analyse, validate
from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.response import principal_gains
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import (
    Agreement,
    AnalysisFacts,
    RecordFit,
    ResidualFacts,
    Root,
    SingularValues,
    ValidationFacts,
)
from ultraquiet.pipeline.identification import group
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import Band
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace

# Frequencies at which models are shown, of the Nyquist frequency: from the lowest that a record resolves.
SHOWN, HIGHEST = 300, 0.97

Model = PolynomialMatrix | StateSpace


@dataclass(frozen=True)
class JudgedBy:
    """By what models are judged: held-out records, records to be simulated, and bands of two comparisons."""

    held_out: str | None
    simulated: tuple[str, ...]
    models_hz: Band
    bench_hz: Band


def validated(
    records: Mapping[str, Record],
    models: Mapping[str, PolynomialMatrix],
    plant: StateSpace,
    bench: Any,
    judge: JudgedBy,
) -> Outcome[ValidationFacts]:
    """Compare models with records, with each other and, on a simulated bench, with its own response."""
    candidates: dict[str, Model] = {**models, stored.PLANT: plant}
    values: dict[str, Record] = {}
    fits: dict[str, RecordFit] = {}
    for name in (name for name in judge.simulated if name in records):
        values[stored.simulated(name)], fits[name] = _against_record(records[name], candidates)
    reference = models.get(stored.PREFERRED)
    others = {name: model for name, model in models.items() if name != stored.PREFERRED}
    agreement = {} if reference is None else {n: _agreement(reference, m, judge.models_hz) for n, m in others.items()}
    truth = getattr(bench, "linear_model", None)
    facts = ValidationFacts(
        records=fits,
        agreement=agreement,
        residuals=None if reference is None else _residuals(reference, records, judge),
        against_bench=None if truth is None else _against_bench(truth(), candidates, judge.bench_hz),
    )
    return Outcome(values, facts)


def worth_showing(records: Mapping[str, Record], held_out: str | None) -> tuple[str, ...]:
    """Return the record that models are shown beside: of what was held out the first, or the first of all."""
    names = [name for name in records if held_out is not None and name in (held_out, f"{held_out}-1")]
    return tuple(names[:1] or list(records)[:1])


def _residuals(reference: PolynomialMatrix, records: Mapping[str, Record], judge: JudgedBy) -> ResidualFacts | None:
    """Return what is left of held-out records; None where none are held out."""
    if judge.held_out is None:
        return None
    members = group(records, judge.held_out)
    tests = [
        validate.residual_test(column(reference, k), r if len(r.actuators) == 1 else r.pick([k]))
        for k, r in enumerate(members)
    ]
    return ResidualFacts(
        whiteness_p_median=float(np.median([t.whiteness_p for t in tests])),
        correlation_p_median=float(np.median([t.correlation_p for t in tests])),
    )


def _against_record(record: Record, models: Mapping[str, Model]) -> tuple[Record, RecordFit]:
    """Return simulations of the sensor that moved most, one output a model, and how well each meets the record."""
    driven = int(np.argmax(np.ptp(record.inputs, axis=1)))
    heard = int(np.argmax(np.std(record.outputs, axis=1) / _sizes(record)))
    fits = {
        name: float(validate.compare(model, record, initial="rest", offset=False).fit_percent[heard])
        for name, model in models.items()
    }
    outputs = {name: validate.simulated(m, record, "rest", offset=False)[heard] for name, m in models.items()}
    # What an unstable model says is no number.
    outputs = {name: output for name, output in outputs.items() if np.isfinite(output).all()}
    simulated = Record(record.inputs, list(outputs.values()), record.rate_hz, record.actuators, list(outputs))
    clipped = record.clipped()[heard]
    return simulated, RecordFit(channel=heard, actuator=driven, fit_percent=fits, clipped_samples=clipped)


def _sizes(record: Record) -> FloatArray:
    """Return what sensors of unlike units are measured by: their ranges; those without by what they read."""
    ranges = np.array([(c.high - c.low) / 2 for c in record.sensors])
    return ranges if np.isfinite(ranges).all() else np.ones(len(record.sensors))


def _against_bench(truth: StateSpace, models: Mapping[str, Model], band_hz: Band) -> dict[str, Agreement]:
    return {name: _agreement(truth, model, band_hz) for name, model in models.items()}


def column(model: PolynomialMatrix, k: int) -> PolynomialMatrix:
    """Return what one actuator does to every sensor."""
    return PolynomialMatrix([[row[k]] for row in model.rows])


def _agreement(first: Model, second: Model, band_hz: tuple[float, float]) -> Agreement:
    difference = validate.bode_agreement(first, second, band_hz)
    diagonal = np.arange(min(difference.worst_gain_db.shape))
    return Agreement(
        band_hz=band_hz,
        diagonal_gain_db=float(difference.worst_gain_db[diagonal, diagonal].max()),
        diagonal_phase_deg=float(difference.worst_phase_deg[diagonal, diagonal].max()),
        median_gain_db=float(np.median(np.abs(difference.gain_db))),
    )


def shown_hz(rate_hz: float, longest_s: float) -> FloatArray:
    """Return the frequencies at which models are shown: what the longest record resolves, up to near Nyquist."""
    high = HIGHEST * rate_hz / 2
    return np.geomspace(min(2 / longest_s, high / 10), high, SHOWN)


def analysed(plant: StateSpace, paper: PolynomialMatrix | None, f_hz: FloatArray) -> Outcome[AnalysisFacts]:
    """Return poles, zeros, transmission zeros, singular values and symmetry of the design model and the paper's."""
    G = plant.frequency_response(f_hz)
    square = G.shape[0] == G.shape[1]
    gains = None
    if paper is not None:
        gains = principal_gains(paper.frequency_response(f_hz))
    facts = AnalysisFacts(
        f_hz=f_hz,
        singular_values=SingularValues(plant=analyse.singular_values(plant, f_hz), paper=gains),
        poles=_table(analyse.poles(plant)),
        transmission_zeros=_table(analyse.zeros(plant)),
        paper_zeros=()
        if paper is None
        else tuple(_table(analyse.roots(m.zeros(0), m.rate_hz)) for m in _diagonal(paper)),
        reciprocity_error=analyse.reciprocity_error(G) if square else None,
        threefold_error=analyse.threefold_error(G) if paper is not None and G.shape[:2] == (6, 6) else None,
        dominance_db=_dominance(G) if square and G.shape[0] > 1 else None,
    )
    return Outcome({}, facts)


def _diagonal(model: PolynomialMatrix) -> list[PolynomialModel]:
    return [row[i] for i, row in enumerate(model.rows) if i < len(row)]


def _table(roots: analyse.Roots) -> tuple[Root, ...]:
    """Return one row per real root or conjugate pair below the Nyquist frequency."""
    rows = zip(roots.values, roots.frequency_hz, roots.zeta, roots.outside, strict=True)
    return tuple(
        Root(frequency_hz=float(f), zeta=float(z), outside=bool(out), real=float(v.real), imag=float(v.imag))
        for v, f, z, out in rows
        if v.imag >= 0 and np.isfinite(f)
    )


def _dominance(G: ComplexArray) -> FloatArray:
    """Return how far the weakest diagonal gain stands above the strongest other gain of its column, in dB."""
    size = np.abs(G)
    own = np.einsum("iif->if", size)
    others = np.where(np.eye(size.shape[0], dtype=bool)[:, :, None], 0.0, size).max(axis=0)
    return (20 * np.log10(own / others)).min(axis=0)
