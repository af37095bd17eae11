"""The stages that judge models: the paper's validation, and what the transfer matrix looks like."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet import analyse, validate
from ultraquiet._base.constraints import FloatArray
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.identification import group
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

# The band over which the paper compares its excitations, and that of the bench's own response.
PAPER_BAND_HZ = (10.0, 250.0)
TRUTH_BAND_HZ = (20.0, 200.0)
SHOWN_HZ = np.geomspace(1.0, 1700.0, 300)


def validated(
    records: Mapping[str, Record], models: Mapping[str, PolynomialMatrix], plant: StateSpace, bench: Any
) -> Outcome:
    """Compare models with the step, the clipping sine, each other and, on a simulated bench, with its own response."""
    every: dict[str, PolynomialMatrix | StateSpace] = {**models, "plant": plant}
    values, facts = _against_records(records, every)
    reference = models["preferred"]
    tested = [validate.residual_test(_row(reference, k), r.pick([k])) for k, r in enumerate(group(records, "judge"))]
    facts |= {
        "agreement": {n: _agreement(reference, m, PAPER_BAND_HZ) for n, m in models.items() if n != "preferred"},
        "residuals": {
            "whiteness_p_median": float(np.median([t.whiteness_p for t in tested])),
            "correlation_p_median": float(np.median([t.correlation_p for t in tested])),
        },
    }
    truth = getattr(bench, "linear_model", None)
    if truth is not None:
        own = truth()
        facts["against_bench"] = {name: _agreement(own, model, TRUTH_BAND_HZ) for name, model in every.items()}
    return Outcome(values, facts)


def _against_records(
    records: Mapping[str, Record], models: Mapping[str, PolynomialMatrix | StateSpace]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return simulations of the driven strut, one row a model, and how well each meets the record."""
    values: dict[str, Any] = {}
    facts: dict[str, Any] = {}
    for name in ("step", "tone"):
        if name not in records:
            continue
        record = records[name]
        driven = int(np.argmax(np.ptp(record.inputs, axis=1)))
        fits = {
            key: float(validate.compare(model, record, initial="rest", offset=False).fit_percent[driven])
            for key, model in models.items()
        }
        said = {key: validate.simulated(m, record, "rest", offset=False)[driven] for key, m in models.items()}
        rows = {key: row for key, row in said.items() if np.isfinite(row).all()}  # an unstable model says nothing
        values[f"simulated-{name}"] = Record(
            record.inputs, list(rows.values()), record.rate_hz, record.actuators, list(rows)
        )
        facts[name] = {"channel": driven, "fit_percent": fits, "clipped_samples": record.clipped()[driven]}
    return values, {"records": facts}


def _row(model: PolynomialMatrix, column: int) -> PolynomialMatrix:
    return PolynomialMatrix([[row[column]] for row in model.rows])


def _agreement(first: Any, second: Any, band_hz: tuple[float, float]) -> dict[str, Any]:
    found = validate.bode_agreement(first, second, band_hz)
    diagonal = np.arange(found.worst_gain_db.shape[0])
    return {
        "band_hz": band_hz,
        "diagonal_gain_db": float(found.worst_gain_db[diagonal, diagonal].max()),
        "diagonal_phase_deg": float(found.worst_phase_deg[diagonal, diagonal].max()),
        "median_gain_db": float(np.median(np.abs(found.gain_db))),
    }


def analysed(plant: StateSpace, paper: PolynomialMatrix) -> Outcome:
    """Return poles, zeros, transmission zeros, singular values and symmetry of the design model and the paper's."""
    G = plant.frequency_response(SHOWN_HZ)
    facts = {
        "f_hz": SHOWN_HZ,
        "singular_values": {
            "plant": analyse.singular_values(plant, SHOWN_HZ),
            "paper": np.linalg.svd(np.moveaxis(paper.frequency_response(SHOWN_HZ), 2, 0), compute_uv=False).T,
        },
        "poles": _table(analyse.poles(plant)),
        "transmission_zeros": _table(analyse.zeros(plant)),
        "paper_zeros": [_table(analyse.roots(m.zeros(0), m.rate_hz)) for m in _diagonal(paper)],
        "reciprocity_error": analyse.reciprocity_error(G),
        "threefold_error": analyse.threefold_error(G) if G.shape[0] == 6 else None,
        "dominance_db": _dominance(G),
    }
    return Outcome({}, facts)


def _diagonal(model: PolynomialMatrix) -> list[Any]:
    return [row[i] for i, row in enumerate(model.rows)]


def _table(roots: analyse.Roots) -> list[dict[str, Any]]:
    """Return one row per real root or conjugate pair below the Nyquist frequency."""
    rows = zip(roots.values, roots.frequency_hz, roots.zeta, roots.outside, strict=True)
    return [
        {"frequency_hz": float(f), "zeta": float(z), "outside": bool(out), "real": v.real, "imag": v.imag}
        for v, f, z, out in rows
        if v.imag >= 0 and np.isfinite(f)
    ]


def _dominance(G: Any) -> FloatArray:
    """Return how far the weakest diagonal gain stands above the strongest other gain of its column, in dB."""
    size = np.abs(G)
    own = np.einsum("iif->if", size)
    others = np.where(np.eye(size.shape[0], dtype=bool)[:, :, None], 0.0, size).max(axis=0)
    return (20 * np.log10(own / others)).min(axis=0)
