"""What the report says of records and models."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.shown.line import counted, figure_or, in_percent
from ultraquiet.identify.successive_orders import frequency_and_damping, poles_by_order
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import (
    Agreement,
    AnalysisFacts,
    PaperFit,
    PlantFacts,
    PreferredModels,
    RankedModel,
    RecordFit,
    RecordPlant,
    ResidualFacts,
    ResponsePlant,
    Root,
    WeightedPlant,
)
from ultraquiet.pipeline.identification import group, sweep_groups
from ultraquiet.pipeline.report.records import noted, span, wires
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.validation import column
from ultraquiet.plot import Figure, study
from ultraquiet.plot.pages import models as pages
from ultraquiet.plot.pages.modes import mode_shapes
from ultraquiet.plot.pages.residuals import chance, residual_chart
from ultraquiet.plot.pages.stabilisation import stabilisation
from ultraquiet.report import Picture, Section, Table
from ultraquiet.validate import residual_test
from ultraquiet.values.channel import squared
from ultraquiet.values.sketch import Sketch, sketch_of

# Zeros nearer to 0 Hz than this share of the Nyquist frequency are those at z = 1, spread by rounding: a triple root is
# good to its cube root.
AT_DC = 1e-4
# Below so many times the band's lower end the zeros of the paper's low order are compared with those of the plant.
LOW = 5.0
FEWEST_ORDERS = 4  # of a stabilisation diagram
DOUBT = 0.01  # a p-value that is doubted
CLEARLY = 5.0  # points of fit
FIT_DOUBTED = 50.0  # percent: a simulation that leaves half of what a sensor's reading does


def identification(result: StudyResult) -> Section:
    """The choice of the order, the ranking of structures and orders, the paper's structure."""
    facts = result.identification.facts
    best, paper = facts.preferred, result.study.paper
    units = dict.fromkeys(squared(c.unit) for c in result.design_plant.sensors)
    sentences, tables, figures = list[str](), list[Table](), list[Picture]()
    figures += _by_order(result.plant.facts) + _stabilisation(result)
    if best is None:
        sentences.append(
            "No records drive one actuator after the other, so no structures were ranked channel by channel."
        )
    else:
        sentences.append(
            f"For all channels alike held-out records prefer {best.structure} of order {best.order}: of the best "
            "structure the smallest order whose loss is within 2 % of the least. The preferred matrix takes what each "
            f"channel's own record prefers: {_counted(best)}."
        )
        sentences += _simulating_better(best, facts.table)
        loss = f"median loss {', '.join(filter(None, units))}".strip() if len(units) == 1 else "median loss"
        columns = ("structure", "order", "median fit %", "worst fit %", loss, "channels ok", "CPU s")
        title = "All channels, judged on records no model has seen; the least loss first, as the geometric mean"
        tables.append(Table(title, columns, _ranking(facts.table)))
        figures.append(pages.fits_by_order(_by_structure(facts.table)))
    if paper is not None and facts.paper:
        title = f"The paper's structure ({paper.structure}, order {paper.order}) from each test signal"
        heads = ("signal", "median fit %", "worst fit %", "channels ok", "all stable", "all invertible", "CPU s")
        tables.append(Table(title, heads, _by_signal(facts.paper)))
    return Section("Identification", sentences, tables, figures)


def _simulating_better(best: PreferredModels, table: Sequence[RankedModel]) -> list[str]:
    """Return a sentence where another model than the preferred simulates clearly better: loss is of one step ahead."""
    taken = next((row for row in table if (row.structure, row.order) == (best.structure, best.order)), None)
    other = max(table, key=lambda row: row.median_fit_percent, default=None)
    if taken is None or other is None or other.median_fit_percent <= taken.median_fit_percent + CLEARLY:
        return []
    fits = [f"{row.structure} {row.order} to {row.median_fit_percent:.1f} %" for row in (taken, other)]
    return [
        "Loss is of one step ahead, where the last reading tells most. Simulated from the inputs alone, as a response "
        f"or a design needs it, held-out records are met in the median by {fits[0]} and by {fits[1]}."
    ]


def _by_order(plant: PlantFacts) -> list[Picture]:
    """Return what the order of the plant was chosen by, where several were tried."""
    if isinstance(plant, ResponsePlant) and len(plant.errors_by_order) > 1:
        return [pages.errors_by_order(plant.errors_by_order, plant.order)]
    if isinstance(plant, WeightedPlant) and len(plant.criterion_by_order) > 1:
        return [pages.criterion_by_order(plant.criterion_by_order, plant.order, plant.criterion)]
    return []


def _stabilisation(result: StudyResult) -> list[Picture]:
    """Return the poles of one order after the other: of the response that was fitted, or of the record."""
    plant, f_hz = result.plant.facts, result.analysis.facts.f_hz
    if isinstance(plant, ResponsePlant):
        roots, taken = dict(plant.modes_by_order), plant.order
    elif not isinstance(plant, RecordPlant):
        return []
    else:
        (record, *_) = group(result.records, result.study.plant.records[0])
        try:
            poles = poles_by_order(record)
        except UltraquietError:
            return []
        roots = {n: frequency_and_damping(each, record.rate_hz) for n, each in poles.items()}
        taken = plant.states if plant.states in roots else None
    if len(roots) < FEWEST_ORDERS:
        return []
    low, high = span(result)
    shown = (f_hz >= low) & (f_hz <= high)
    unit = study.gain_unit(wires(result)).removeprefix("dB").removeprefix(" re ")
    gain = f_hz[shown], result.analysis.facts.singular_values.plant[0, shown], unit
    return [stabilisation(roots, (low, high), taken, gain)]


def _by_structure(table: Sequence[RankedModel]) -> dict[str, list[tuple[int, float, float]]]:
    found: dict[str, list[tuple[int, float, float]]] = {}
    for row in table:
        found.setdefault(row.structure, []).append((row.order, row.median_fit_percent, row.worst_fit_percent))
    return found


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
            figure_or(row.median_fit_percent),
            figure_or(row.worst_fit_percent),
            f"{row.median_loss:.3g}" if np.isfinite(row.median_loss) else "-",
            row.ok,
            f"{row.seconds:.1f}",
        )
        for row in table
    ]


def _by_signal(fits: Mapping[str, PaperFit]) -> list[tuple[object, ...]]:
    return [
        (
            name,
            figure_or(fit.median_fit_percent),
            figure_or(fit.worst_fit_percent),
            fit.ok,
            "yes" if fit.stable else "no",
            "yes" if fit.invertible else "no",
            f"{fit.seconds:.1f}",
        )
        for name, fit in fits.items()
    ]


def validation(result: StudyResult) -> Section:
    """Models beside records, beside each other, and beside the bench's own response where there is one."""
    facts, paper = result.validation.facts, result.study.paper
    first = stored.PREFERRED if paper is None else stored.paper(paper.records[0])
    figures: list[Picture] = [*_residuals(result), *_time_figures(result, (stored.PLANT, first))]
    if paper is not None and result.identification.facts.paper:
        f, k = result.analysis.facts.f_hz, paper.channel - 1
        responses = [(n, f, result.paper_model(n).frequency_response(f)) for n in paper.records]
        figures.append(
            study.bode(responses, wires(result), k, k, paper.band_hz or result.plan.band_hz, noted(result, "bode"))
        )
    tables = [_fits(facts.records)] if facts.records else []
    if facts.against_bench:
        tables.append(_against_bench(facts.against_bench))
    sentences = [] if facts.residuals is None else [_of_residuals(facts.residuals)]
    return Section("Validation", [*_of_plant(result), *sentences, *_doubted(result)], tables, figures)


def _residuals(result: StudyResult) -> list[Picture]:
    """Return what the preferred model leaves of the first record that was held out; nothing where none was."""
    held_out = sweep_groups(result.records, result.study.identify)[1]
    if result.preferred_model is None or held_out is None:
        return []
    record = group(result.records, held_out)[0]
    one = record if len(record.actuators) == 1 else record.pick([0])
    test = residual_test(column(result.preferred_model, 0), one)
    sensors = [c.name for c in record.sensors]
    shown = (sensors, test.autocorrelation, test.band, test.whiteness_p)
    return [residual_chart(stored.PREFERRED, held_out, *shown)]


def _of_plant(result: StudyResult) -> list[str]:
    """Say how well the plant that designs use simulates records."""
    fits = {name: fit.fit_percent.get(stored.PLANT) for name, fit in result.validation.facts.records.items()}
    said = [f"'{name}' by {_fit(fit)} %" for name, fit in fits.items() if fit is not None and np.isfinite(fit)]
    return [f"Simulated from commands alone the design plant meets {' and '.join(said)}."] if said else []


def _of_residuals(p: ResidualFacts) -> str:
    """Say what the tests of residuals found, and what it means for who relies on the model."""
    white, free = (p.whiteness_p_median, p.correlation_p_median)
    left = [
        what for what, found in (("noise of a colour", white), ("motion that the input makes", free)) if found < DOUBT
    ]
    meaning = (
        f"the model leaves {' and '.join(left)} unexplained, so a law needs margins"
        if left
        else "the median channel leaves nothing that such a test tells from chance"
    )
    return (
        f"Residuals of the preferred model on held-out records: median p-value {chance(white)} that they are white, "
        f"{chance(free)} that they are free of the input: {meaning}."
    )


def _of_its_error(share: float | None) -> str:
    return "" if share is None else f" ({in_percent(share)} of its error)"


def _doubted(result: StudyResult) -> list[str]:
    """Say of every record which models simulate it badly, and how much of what they miss is none of the band's."""
    low, high = result.plan.band_hz
    said: list[str] = []
    for name, fit in result.validation.facts.records.items():
        bad = sorted((each, model) for model, each in fit.fit_percent.items() if each < FIT_DOUBTED)
        shares = {model: _error_outside(result, name, fit, model) for _, model in bad}
        each = [f"{model} {fitted:.0f} %{_of_its_error(shares[model])}" for fitted, model in bad]
        outside = f"; in brackets what lies outside {low:.4g}-{high:.4g} Hz" if any(shares.values()) else ""
        if each:
            said.append(f"Fits of '{name}' look bad, a constant would have 0 %: {', '.join(each)}{outside}.")
    return said


def _error_outside(result: StudyResult, name: str, fit: RecordFit, model: str) -> float | None:
    """Return which share of the power of a simulation's error lies outside the band; None where it was not kept."""
    simulated = result.simulated(name)
    rows = {} if simulated is None else dict(zip((c.name for c in simulated.sensors), simulated.outputs, strict=True))
    if model not in rows:
        return None
    record = result.records[name]
    error = record.outputs[fit.channel] - rows[model]
    power, f = np.abs(np.fft.rfft(error)) ** 2, np.fft.rfftfreq(error.size, 1 / record.rate_hz)
    power[1:] *= 2
    low, high = result.plan.band_hz
    return float(power[(f < low) | (f > high)].sum() / power.sum())


def _against_bench(agreements: Mapping[str, Agreement]) -> Table:
    rows = [(name, f"{a.diagonal_gain_db:.2f}", f"{a.diagonal_phase_deg:.1f}") for name, a in agreements.items()]
    low, high = next(iter(agreements.values())).band_hz
    caption = f"Largest error on the diagonal against the bench's own linear response, {low:.4g}-{high:.4g} Hz"
    return Table(caption, ("model", "gain dB", "phase °"), rows)


def _time_figures(result: StudyResult, models: tuple[str, ...]) -> list[Figure]:
    figures: list[Figure] = []
    for name, fit in result.validation.facts.records.items():
        simulated = result.simulated(name)
        if simulated is not None:
            rows = dict(zip((c.name for c in simulated.sensors), simulated.outputs, strict=True))
            shown = {key: rows[key] for key in models if key in rows}
            note = noted(result, "simulation")
            figures.append(study.simulation(name, result.records[name], shown, fit.actuator, fit.channel, note))
    return figures


def _fits(records: Mapping[str, RecordFit]) -> Table:
    models = next(iter(records.values())).fit_percent
    rows = [
        (name, *(_fit(percent) for percent in fit.fit_percent.values()), fit.clipped_samples)
        for name, fit in records.items()
    ]
    return Table(
        "Simulated fit in % of the sensor that moved most, clipped as it is", ("record", *models, "clipped"), rows
    )


def _fit(percent: float) -> str:
    return f"{percent:.1f}" if np.isfinite(percent) else "unstable"


def analysis(result: StudyResult) -> Section:
    """Singular values, poles, zeros, symmetry."""
    facts = result.analysis.facts
    bands = {"design plant": facts.singular_values.plant}
    if facts.singular_values.paper is not None:
        bands["the paper's structure"] = facts.singular_values.paper
    nyquist = next(iter(result.records.values())).rate_hz / 2
    poles = [(f"{p.frequency_hz:.2f}", f"{p.zeta:.4f}", "unstable" if p.outside else "") for p in facts.poles]
    tables = [Table("Poles of the design plant", ("Hz", "damping", ""), _merged(poles), folded=True)]
    sentences = [_about_zeros(facts.transmission_zeros, nyquist), *_about_symmetry(facts)]
    if facts.paper_zeros:
        low_hz = LOW * result.plan.band_hz[0]
        sensors = [c.name for c in result.design_plant.sensors]
        low = [(sensors[k], _frequencies(zeros, 0.0, low_hz)) for k, zeros in enumerate(facts.paper_zeros)]
        caption = f"Zeros outside the unit circle below {low_hz:.4g} Hz, paper's structure"
        tables.insert(0, Table(caption, ("channel", "Hz"), low))
        said = "" if result.study.paper is None else result.study.paper.zeros
        sentences.append(_about_low_zeros(facts, low_hz, AT_DC * nyquist, said))
    low, high = span(result)
    scene = mode_shapes(result.design_plant, (low, high), _sketch(result))
    figures: list[Picture] = [
        pages.poles_and_zeros(
            [(p.frequency_hz, p.zeta) for p in facts.poles],
            [(z.frequency_hz, z.zeta) for z in facts.transmission_zeros],
            span(result),
        ),
        *([] if scene is None else [scene]),
        pages.singular_value_chart(facts.f_hz, bands, wires(result), noted(result, "singular_values")),
    ]
    return Section("Analysis", sentences, tables, figures)


def _sketch(result: StudyResult) -> Sketch | None:
    """Return what the bench looks like, where it says so and its readings are the model's."""
    return sketch_of(result.bench) if result.study.blending is None else None


def _about_zeros(zeros: Sequence[Root], nyquist: float) -> str:
    if not zeros:
        return "The design plant has no transmission zeros."
    dc_hz = AT_DC * nyquist
    at_dc = sum(z.frequency_hz < dc_hz for z in zeros)
    beyond = sum(z.outside and z.frequency_hz > nyquist for z in zeros)
    outside = _frequencies(zeros, dc_hz, nyquist)
    said = [f"outside the unit circle {'none' if outside == 'none' else f'at {outside} Hz'} up to Nyquist"]
    said += [f"{at_dc} at 0 Hz"] if at_dc else []
    said += [f"{counted(beyond, 'real one')} beyond Nyquist, as sampling makes them"] if beyond else []
    return (
        f"The design plant has {counted(len(zeros), 'transmission zero')} (conjugates counted once): {', '.join(said)}."
    )


def _about_low_zeros(facts: AnalysisFacts, low_hz: float, dc_hz: float, said: str) -> str:
    own = _frequencies(facts.transmission_zeros, dc_hz, low_hz)
    return (
        f"Outside the unit circle below {low_hz:.4g} Hz the paper's structure has the zeros of the table, the design "
        f"plant has: {own}. {said}".rstrip()
    )


def _about_symmetry(facts: AnalysisFacts) -> list[str]:
    """Say what a square plant's symmetries and diagonal are worth."""
    if facts.reciprocity_error is None or facts.dominance_db is None:
        return []
    off, turned = in_percent(float(np.median(facts.reciprocity_error)), 1), ""
    if facts.threefold_error is not None:
        by = in_percent(float(np.median(facts.threefold_error)), 1)
        turned = f", from itself turned by 120 degrees by {by}"
    return [
        f"G differs from its transpose by {off} (median over frequency){turned}; "
        f"the weakest diagonal gain stands {np.median(facts.dominance_db):.0f} dB above the rest of its column."
    ]


def _frequencies(roots: Sequence[Root], low_hz: float, high_hz: float) -> str:
    """Return the frequencies of the roots outside the unit circle in [low, high)."""
    within = [r.frequency_hz for r in roots if r.outside and low_hz <= r.frequency_hz < high_hz]
    return ", ".join(f"{f:.3g}" for f in within) or "none"


def _merged(rows: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """Return rows with how often each stands, in place of repetitions."""
    counts = {row: rows.count(row) for row in dict.fromkeys(rows)}
    return [(f, z, " ".join(filter(None, (f"x {n}" if n > 1 else "", word)))) for (f, z, word), n in counts.items()]
