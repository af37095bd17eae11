"""The stages that judge models: the paper's validation, and what the transfer matrix looks like."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet import analyse, validate
from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.pipeline.cache import Outcome
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
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace

# The band over which the paper compares its excitations, and that of the bench's own response.
PAPER_BAND_HZ = (10.0, 250.0)
TRUTH_BAND_HZ = (20.0, 200.0)
# Records that models are shown beside.
SIMULATED = ("step", "tone")
SHOWN_HZ = np.geomspace(1.0, 1700.0, 300)

Model = PolynomialMatrix | StateSpace


def validated(
    records: Mapping[str, Record], models: Mapping[str, PolynomialMatrix], plant: StateSpace, bench: Any
) -> Outcome[ValidationFacts]:
    """Compare models with the step, the clipping sine, each other and, on a simulated bench, with its own response."""
    candidates: dict[str, Model] = {**models, stored.PLANT: plant}
    reference = models[stored.PREFERRED]
    tests = [validate.residual_test(_column(reference, k), r.pick([k])) for k, r in enumerate(group(records, "judge"))]
    values: dict[str, Record] = {}
    fits: dict[str, RecordFit] = {}
    for name in (name for name in SIMULATED if name in records):
        values[stored.simulated(name)], fits[name] = _against_record(records[name], candidates)
    others = {name: model for name, model in models.items() if name != stored.PREFERRED}
    truth = getattr(bench, "linear_model", None)
    facts = ValidationFacts(
        records=fits,
        agreement={name: _agreement(reference, model, PAPER_BAND_HZ) for name, model in others.items()},
        residuals=ResidualFacts(
            whiteness_p_median=float(np.median([t.whiteness_p for t in tests])),
            correlation_p_median=float(np.median([t.correlation_p for t in tests])),
        ),
        against_bench=None if truth is None else _against_bench(truth(), candidates),
    )
    return Outcome(facts, values)


def _against_record(record: Record, models: Mapping[str, Model]) -> tuple[Record, RecordFit]:
    """Return simulations of the driven strut, one output a model, and how well each meets the record."""
    driven = int(np.argmax(np.ptp(record.inputs, axis=1)))
    fits = {
        name: float(validate.compare(model, record, initial="rest", offset=False).fit_percent[driven])
        for name, model in models.items()
    }
    outputs = {name: validate.simulated(m, record, "rest", offset=False)[driven] for name, m in models.items()}
    # What an unstable model says is no number.
    outputs = {name: output for name, output in outputs.items() if np.isfinite(output).all()}
    simulated = Record(record.inputs, list(outputs.values()), record.rate_hz, record.actuators, list(outputs))
    return simulated, RecordFit(channel=driven, fit_percent=fits, clipped_samples=record.clipped()[driven])


def _against_bench(truth: StateSpace, models: Mapping[str, Model]) -> dict[str, Agreement]:
    return {name: _agreement(truth, model, TRUTH_BAND_HZ) for name, model in models.items()}


def _column(model: PolynomialMatrix, column: int) -> PolynomialMatrix:
    return PolynomialMatrix([[row[column]] for row in model.rows])


def _agreement(first: Model, second: Model, band_hz: tuple[float, float]) -> Agreement:
    difference = validate.bode_agreement(first, second, band_hz)
    diagonal = np.arange(difference.worst_gain_db.shape[0])
    return Agreement(
        band_hz=band_hz,
        diagonal_gain_db=float(difference.worst_gain_db[diagonal, diagonal].max()),
        diagonal_phase_deg=float(difference.worst_phase_deg[diagonal, diagonal].max()),
        median_gain_db=float(np.median(np.abs(difference.gain_db))),
    )


def analysed(plant: StateSpace, paper: PolynomialMatrix) -> Outcome[AnalysisFacts]:
    """Return poles, zeros, transmission zeros, singular values and symmetry of the design model and the paper's."""
    G = plant.frequency_response(SHOWN_HZ)
    paper_gains = np.linalg.svd(np.moveaxis(paper.frequency_response(SHOWN_HZ), 2, 0), compute_uv=False).T
    facts = AnalysisFacts(
        f_hz=SHOWN_HZ,
        singular_values=SingularValues(
            plant=analyse.singular_values(plant, SHOWN_HZ), paper=paper_gains.astype(np.float64)
        ),
        poles=_table(analyse.poles(plant)),
        transmission_zeros=_table(analyse.zeros(plant)),
        paper_zeros=tuple(_table(analyse.roots(m.zeros(0), m.rate_hz)) for m in _diagonal(paper)),
        reciprocity_error=analyse.reciprocity_error(G),
        threefold_error=analyse.threefold_error(G) if G.shape[0] == 6 else None,
        dominance_db=_dominance(G),
    )
    return Outcome(facts)


def _diagonal(model: PolynomialMatrix) -> list[PolynomialModel]:
    return [row[i] for i, row in enumerate(model.rows)]


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
