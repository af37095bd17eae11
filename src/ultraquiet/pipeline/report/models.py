"""What the report says of records and models."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import (
    Agreement,
    AnalysisFacts,
    PaperFit,
    PreferredModels,
    RankedModel,
    RecordFit,
    Root,
)
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.validation import SHOWN_HZ
from ultraquiet.plot import Figure, paper
from ultraquiet.report import Section, Table
from ultraquiet.spectra import psd
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

SHOWN_SIGNALS = ("chirp", "noise", "prbs")
# Strut 2 is the one whose functions the paper prints, eqs. (11) and (12).
PAPER_STRUT = 1
# Zeros nearer to 0 Hz than this are those at z = 1, spread by rounding: a triple root is good to its cube root.
AT_DC_HZ = 0.1
# Below this the paper's fifth-order zeros are compared with physics, which has none.
LOW_HZ = 50.0


def excitation(result: StudyResult) -> Section:
    """Test signals, and the responses to one of them."""
    shown = {}
    for name in SHOWN_SIGNALS:
        if f"{name}-1" in result.records:
            r = result.records[f"{name}-1"]
            power = psd(r.inputs[0], r.rate_hz)
            shown[name] = (r.time_s, r.inputs[0], power.f_hz, power.values.ravel())
    figures: list[Figure] = [paper.test_signals(shown)] if shown else []
    if "chirp-1" in result.records:
        figures.append(paper.responses_to_one_strut(result.records["chirp-1"], 0))
    clipped = {name: max(r.clipped()) for name, r in result.records.items() if max(r.clipped())}
    words = ", ".join(f"{name} ({count} samples)" for name, count in clipped.items()) or "none"
    return Section("Excitation", [f"Records in which a sensor stood at its limits: {words}."], figures=figures)


def identification(result: StudyResult) -> Section:
    """The ranking of structures and orders, the paper's structure, the plant for design."""
    facts, settings = result.identification.facts, result.study.identify
    best, plant = facts.preferred, result.plant.facts
    sentences = [
        f"For all channels alike held-out records prefer {best.structure} of order {best.order}. The preferred "
        f"matrix takes what each channel's own record prefers: {_counted(best)}.",
        f"The plant that designs use is the whole matrix at once ({result.study.plant.method}), {plant.states} states."
        f" {plant.status}",
    ]
    columns = ("structure", "order", "median fit %", "worst fit %", "median loss V²", "ok", "CPU s")
    ranking = Table("All channels, judged on records no model has seen; best first", columns, _ranking(facts.table))
    title = f"The paper's structure ({settings.paper_structure}, order {settings.paper_order}) from each test signal"
    heads = ("signal", "median fit %", "worst fit %", "ok", "all stable", "all invertible", "s")
    fifth = Table(title, heads, _by_signal(facts.paper))
    responses = [(name, SHOWN_HZ, m.frequency_response(SHOWN_HZ)) for name, m in _shown_models(result).items()]
    return Section("Identification", sentences, [ranking, fifth], [paper.bode_grid(responses, (2.0, 500.0))])


def _counted(best: PreferredModels) -> str:
    """Return how often each structure and order was chosen, and the verdicts."""
    chosen = [name for row in best.by_channel for name in row]
    counts = ", ".join(f"{chosen.count(name)} x {name}" for name in sorted(dict.fromkeys(chosen)))
    return f"{counts}; " + ", ".join(f"{count} {word}" for word, count in best.verdicts.items())


def _ranking(table: Sequence[RankedModel]) -> list[tuple[object, ...]]:
    return [
        (
            row.structure,
            row.order,
            f"{row.median_fit_percent:.1f}",
            f"{row.worst_fit_percent:.1f}",
            f"{row.median_loss:.3g}",
            row.ok,
            f"{row.seconds:.1f}",
        )
        for row in table
    ]


def _by_signal(fits: Mapping[str, PaperFit]) -> list[tuple[object, ...]]:
    return [
        (
            name,
            f"{fit.median_fit_percent:.1f}",
            f"{fit.worst_fit_percent:.1f}",
            fit.ok,
            "yes" if fit.stable else "no",
            "yes" if fit.invertible else "no",
            f"{fit.seconds:.1f}",
        )
        for name, fit in fits.items()
    ]


def _shown_models(result: StudyResult) -> dict[str, StateSpace | PolynomialMatrix]:
    first = result.study.identify.paper_records[0]
    return {
        "design plant": result.design_plant,
        "preferred": result.preferred_model,
        f"order {result.study.identify.paper_order}, {first}": result.paper_model(first),
    }


def validation(result: StudyResult) -> Section:
    """The paper's step, sine and Bode comparisons, and the bench's own response where there is one."""
    facts = result.validation.facts
    names = result.study.identify.paper_records
    figures = _time_figures(result, (stored.paper(names[0]), stored.PLANT))
    responses = [(n, SHOWN_HZ, result.paper_model(n).frequency_response(SHOWN_HZ)) for n in names]
    figures.append(paper.bode(responses, PAPER_STRUT, PAPER_STRUT, (5.0, 250.0)))
    tables = [_fits(facts.records)] if facts.records else []
    if facts.against_bench:
        tables.append(_against_bench(facts.against_bench))
    p = facts.residuals
    sentence = (
        f"Residuals of the preferred model on held-out records: median p-value {p.whiteness_p_median:.2g} that they "
        f"are white, {p.correlation_p_median:.2g} that they are free of the input."
    )
    return Section("Validation", [sentence], tables, figures)


def _against_bench(agreements: Mapping[str, Agreement]) -> Table:
    rows = [(name, f"{a.diagonal_gain_db:.2f}", f"{a.diagonal_phase_deg:.1f}") for name, a in agreements.items()]
    low, high = next(iter(agreements.values())).band_hz
    caption = f"Largest error on the diagonal against the bench's own linear response, {low:g}-{high:g} Hz"
    return Table(caption, ("model", "gain dB", "phase °"), rows)


def _time_figures(result: StudyResult, models: tuple[str, ...]) -> list[Figure]:
    figures: list[Figure] = []
    for name, draw in (("step", paper.step_response), ("tone", paper.sine_response)):
        simulated = result.simulated(name)
        if simulated is not None:
            rows = dict(zip((c.name for c in simulated.sensors), simulated.outputs, strict=True))
            channel = result.validation.facts.records[name].channel
            figures.append(draw(result.records[name], {key: rows[key] for key in models if key in rows}, channel))
    return figures


def _fits(records: Mapping[str, RecordFit]) -> Table:
    models = next(iter(records.values())).fit_percent
    rows = [
        (name, *(_fit(percent) for percent in fit.fit_percent.values()), fit.clipped_samples)
        for name, fit in records.items()
    ]
    return Table(
        "Simulated fit in % on the driven strut, clipped like its sensor", ("record", *models, "clipped"), rows
    )


def _fit(percent: float) -> str:
    return f"{percent:.1f}" if np.isfinite(percent) else "unstable"


def analysis(result: StudyResult) -> Section:
    """Singular values, poles, zeros, symmetry."""
    facts = result.analysis.facts
    bands = {"design plant": facts.singular_values.plant, "the paper's structure": facts.singular_values.paper}
    low = [(k + 1, _frequencies(zeros, 0.0, LOW_HZ)) for k, zeros in enumerate(facts.paper_zeros)]
    poles = [(f"{p.frequency_hz:.2f}", f"{p.zeta:.4f}", "unstable" if p.outside else "") for p in facts.poles]
    tables = [
        Table(f"Zeros outside the unit circle below {LOW_HZ:g} Hz, paper's structure", ("strut", "Hz"), low),
        Table("Poles of the design plant", ("Hz", "damping", ""), _merged(poles)),
    ]
    sentences = [_about_zeros(facts.transmission_zeros, result.records), _about_symmetry(facts)]
    sentences.append(_about_low_zeros(facts))
    return Section("Analysis", sentences, tables, [paper.singular_values(facts.f_hz, bands)])


def _about_zeros(zeros: Sequence[Root], records: Mapping[str, Record]) -> str:
    nyquist = next(iter(records.values())).rate_hz / 2
    at_dc = sum(z.frequency_hz < AT_DC_HZ for z in zeros)
    beyond = sum(z.outside and z.frequency_hz > nyquist for z in zeros)
    return (
        f"The design plant has {len(zeros)} transmission zeros (conjugates counted once): {at_dc} at 0 Hz, outside the "
        f"unit circle between {AT_DC_HZ:g} Hz and Nyquist {_frequencies(zeros, AT_DC_HZ, nyquist)}, and {beyond} real "
        f"ones beyond Nyquist, as sampling makes them."
    )


def _about_low_zeros(facts: AnalysisFacts) -> str:
    own = _frequencies(facts.transmission_zeros, AT_DC_HZ, LOW_HZ)
    return (
        f"Outside the unit circle below {LOW_HZ:g} Hz the paper's fifth-order structure has the zeros of the table, "
        f"the design plant has: {own}. The physics, eq. (10), has its zeros at 0 Hz: what a model of order five adds "
        f"there comes from its order."
    )


def _about_symmetry(facts: AnalysisFacts) -> str:
    threefold = facts.threefold_error
    turned = "" if threefold is None else f", from itself turned by 120 degrees by {np.median(threefold):.1%}"
    return (
        f"G differs from its transpose by {np.median(facts.reciprocity_error):.1%} (median over frequency){turned}; "
        f"the weakest diagonal gain stands {np.median(facts.dominance_db):.0f} dB above the rest of its column."
    )


def _frequencies(roots: Sequence[Root], low_hz: float, high_hz: float) -> str:
    """Return the frequencies of the roots outside the unit circle in [low, high)."""
    within = [r.frequency_hz for r in roots if r.outside and low_hz <= r.frequency_hz < high_hz]
    return ", ".join(f"{f:.3g}" for f in within) or "none"


def _merged(rows: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """Return rows with how often each stands, in place of repetitions."""
    counts = {row: rows.count(row) for row in dict.fromkeys(rows)}
    return [(f, z, " ".join(filter(None, (f"x {n}" if n > 1 else "", word)))) for (f, z, word), n in counts.items()]
