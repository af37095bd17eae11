"""What the report says of excitation and its quality, and of the response that was measured against models."""

from collections.abc import Sequence

import numpy as np

from ultraquiet import spectra
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import counted, in_percent, opening
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark, frequency_axis
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import ResponsePlant, WeightedPlant
from ultraquiet.pipeline.identification import group, grouped
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.tables.paper import Shown
from ultraquiet.plot import study
from ultraquiet.plot.pages.transfer import NamedResponse, shown_lines, transfer_grid
from ultraquiet.report import Picture, Section, Table
from ultraquiet.spectra.coherence import TRUSTED
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, Record, StateSpace

MOST_SIGNALS = 4  # of different test signals that are drawn
WIDER = 5.0  # what is drawn of a response, beyond either end of the band


def noted(result: StudyResult, figure: Shown) -> str:
    """Return where a paper shows the same, if this is the study of one and says so."""
    where = "" if result.study.paper is None else result.study.paper.figures.get(figure, "")
    return f" (Paper: {where}.)" if where else ""


def wires(result: StudyResult) -> study.Wires:
    """Return the actuators and sensors of the design model."""
    return result.design_plant.actuators, result.design_plant.sensors


def span(result: StudyResult) -> tuple[float, float]:
    """Return the frequencies over which responses are drawn."""
    low, high = result.plan.band_hz
    f = result.analysis.facts.f_hz
    return max(low / WIDER, float(f[0])), min(high * WIDER, float(f[-1]))


def excitation(result: StudyResult) -> Section:
    """Test signals, how loud they were, what clipped, and how much of the readings they explain."""
    shown = _signals(result)
    figures: list[Picture] = [study.excitation_signals(shown, noted(result, "excitation"))] if shown else []
    coherent = _coherence(result)
    if coherent is not None:
        figures.append(coherent)
    for name, (record, actuator) in list(shown.items())[:1]:
        figures.append(study.responses(name, record, actuator, noted(result, "responses")))
    return Section("Excitation", [_levels_in_words(result)], [_levels(result)], figures, _clipped(result))


def _signals(result: StudyResult) -> dict[str, tuple[Record, int]]:
    """Return the test signals that are drawn, each with a record of it and the actuator that sent it.

    A record during which no command moved, of the noise alone, is none.
    """
    paper = result.study.paper
    groups = {name: result.records[members[0]] for name, members in grouped(result.records).items()}
    groups = {name: record for name, record in groups.items() if np.any(np.ptp(record.inputs, axis=1))}
    asked = [name for name in paper.records if name in groups] if paper else list(groups)[:MOST_SIGNALS]
    return {name: (groups[name], int(np.argmax(np.ptp(groups[name].inputs, axis=1)))) for name in asked}


def _levels_in_words(result: StudyResult) -> str:
    records = result.records.values()
    clipped = {name: sum(r.clipped()) for name, r in result.records.items() if any(r.clipped())}
    seconds, rate_hz = sum(r.duration_s for r in records), next(iter(records)).rate_hz
    text = f"{counted(len(records), 'record')}, {seconds:.0f} s at {rate_hz:g} Hz. "
    if not clipped:
        return text + "No sensor stood at its limits."
    name = max(clipped, key=lambda n: clipped[n] / result.records[n].outputs.size)
    share = in_percent(clipped[name] / result.records[name].outputs.size, 1)
    return (
        f"{text}In {len(clipped)} of them a sensor stood at its limits, most in '{name}' with {share} of all "
        "readings: what is clipped answers no linear model, and fits of such records are to be read with that in mind."
    )


def _clipped(result: StudyResult) -> list[str]:
    counts = {name: max(r.clipped()) for name, r in result.records.items() if max(r.clipped())}
    words = ", ".join(f"{name} ({counted(count, 'sample')})" for name, count in counts.items()) or "none"
    return [f"Records in which a sensor stood at its limits: {words}."]


def _levels(result: StudyResult) -> Table:
    """Return how loud each group of records was, beside the limits of the channels."""
    rows: list[tuple[object, ...]] = []
    for name in grouped(result.records):
        members = group(result.records, name)
        loudest = max(members, key=lambda r: float(np.abs(r.inputs).max()))
        k = int(np.abs(loudest.inputs).max(axis=1).argmax())
        heard = max(members, key=lambda r: float(np.abs(r.outputs).max()))
        i = int(np.abs(heard.outputs).max(axis=1).argmax())
        command, reading = loudest.actuators[k], heard.sensors[i]
        sent, read = float(np.abs(loudest.inputs[k]).max()), float(np.abs(heard.outputs[i]).max())
        seconds = sum(r.duration_s for r in members)
        clipped = sum(sum(r.clipped()) for r in members)
        shares = _share(sent, command.low, command.high), _share(read, reading.low, reading.high)
        cells = (command.in_unit(sent, 3), shares[0], reading.in_unit(read, 3), shares[1])
        rows.append((name, len(members), f"{seconds:.1f}", *(c.strip() for c in cells), clipped))
    columns = (
        "records",
        "number",
        "s",
        "largest command",
        "of its limit",
        "largest reading",
        "of its limit",
        "clipped",
    )
    return Table("Levels of every test signal", columns, rows, folded=True)


def _share(size: float, low: float, high: float) -> str:
    limit = max(abs(low), abs(high))
    return in_percent(size / limit) if np.isfinite(limit) and limit > 0 else "-"


def _coherence(result: StudyResult) -> Chart | None:
    """Return how much of each reading the records of a sweep explain, each actuator's on its own sensor."""
    table = result.study.identify
    names = [n for n in (table.records, *grouped(result.records)) if n is not None and n in grouped(result.records)]
    members = group(result.records, names[0])
    curves: list[Curve] = []
    for k, record in enumerate(members):
        try:
            found = spectra.coherence(record)
        except InputError:
            return None
        sensor = k if len(members) > 1 and k < len(record.sensors) else int(np.argmax(np.ptp(record.outputs, axis=1)))
        inside = (found.f_hz > 0) & (found.f_hz <= span(result)[1])
        if not inside.any():
            return None
        commands = found.actuators[0].name if len(found.actuators) == 1 else f"all {len(found.actuators)} commands"
        label = f"{commands} → {record.sensors[sensor].name}"
        curves.append(Curve(label, found.f_hz[inside], found.multiple[sensor, inside], f"law-{k % 8 + 1}"))
    caption = (
        f"Share of each reading's power that the command explains, '{names[0]}', "
        f"{spectra.coherence(members[0]).estimator}. {_least_coherent(curves, result.plan.band_hz)}"
    )
    marks = [Mark(f"trusted above {TRUSTED:g}", y=TRUSTED)]
    panel = ChartPanel(frequency_axis(), Axis("coherence (1)", range=(0.0, 1.02)), curves, "", (), marks, height=200)
    return Chart("coherence", "Coherence", caption, [panel])


def _least_coherent(curves: Sequence[Curve], band_hz: tuple[float, float]) -> str:
    """Return a sentence on the least coherence over a band (Hz), which may be narrower than the lines are apart."""
    low, high = band_hz
    inside = [(c, (np.asarray(c.x) >= low) & (np.asarray(c.x) <= high)) for c in curves]
    values = [(float(np.asarray(c.y)[at].min()), c.name) for c, at in inside if at.any()]
    where = f"From {low:.4g} to {high:.4g} Hz"
    if not values:
        return f"{where} there is no line of it."
    least, name = min(values)
    # A line between sharp modes is as incoherent by what leaks from them as by noise; the share cannot tell which.
    low_share = "most of the reading there is noise, or leaks from modes narrower than the resolution"
    meant = "every response there can be trusted" if least >= TRUSTED else low_share
    return f"{where} the least is {least:.2f}, {name}: {meant}."


def response(result: StudyResult) -> Section:
    """The response that was measured, with its confidence, against models: every channel."""
    measured = result.response
    f = result.analysis.facts.f_hz if measured is None else measured.f_hz
    lines = shown_lines(f, span(result))
    picked = None if measured is None else _at(measured, lines)
    models = [
        NamedResponse(name, model.frequency_response(f[lines]), colour)
        for (name, model), colour in zip(shown_models(result).items(), ("chosen", "law-1", "law-2"), strict=False)
    ]
    actuators, sensors = (", ".join(c.name for c in side) for side in wires(result))
    unit = study.gain_unit(wires(result)).removeprefix("dB").removeprefix(" re ")
    gains = f", in {unit}" if unit else ""
    text = f"From {actuators} to {sensors}{gains}. The plant that designs use is the whole matrix at once "
    text += f"({_order(result)}). "
    text += opening(result.plant.facts.status)
    if measured is None:
        text += " It was fitted to a record, so there is no response beside it that owes nothing to a model."
    return Section("Response", [text], [], [transfer_grid(f[lines], picked, models, wires(result))])


def _order(result: StudyResult) -> str:
    """Return by which method the plant came and how many states it has, where these are more than its poles with both.

    Poles that several channels share need as many states as their residues have directions, and a delay has its own.
    """
    method, plant = result.study.plant.method, result.plant.facts
    if isinstance(plant, ResponsePlant | WeightedPlant) and plant.order != plant.states:
        return f"{method} of order {plant.order}, realised with {counted(plant.states, 'state')}"
    return f"{method}, {counted(plant.states, 'state')}"


def _at(measured: FrequencyResponse, lines: Sequence[int] | np.ndarray) -> FrequencyResponse:
    variance = None if measured.variance is None else measured.variance[:, :, lines]
    return FrequencyResponse(
        measured.f_hz[lines],
        measured.values[:, :, lines],
        estimator=measured.estimator,
        actuators=measured.actuators,
        sensors=measured.sensors,
        variance=variance,
    )


def shown_models(result: StudyResult) -> dict[str, StateSpace | PolynomialMatrix]:
    """Return the models that stand beside the measured response, the design plant first."""
    shown: dict[str, StateSpace | PolynomialMatrix] = {"design plant": result.design_plant}
    if result.preferred_model is not None:
        shown["preferred"] = result.preferred_model
    paper = result.study.paper
    if paper is not None and stored.paper(paper.records[0]) in result.identification.values:
        shown[f"order {paper.order}, {paper.records[0]}"] = result.paper_model(paper.records[0])
    return shown
