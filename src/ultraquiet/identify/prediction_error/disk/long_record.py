"""Prediction-error models of records longer than memory: one pass over the file an iteration."""

from dataclasses import asdict, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.files import LongRecord
from ultraquiet.identify import chance
from ultraquiet.identify.feedback import free_of_inputs_in
from ultraquiet.identify.long_record_statistics import LongRecordStatistics, survey
from ultraquiet.identify.prediction_error import fit as one_fit
from ultraquiet.identify.prediction_error import race
from ultraquiet.identify.prediction_error.damping_policy import CONVERGED
from ultraquiet.identify.prediction_error.disk.passes import LongRecordPoint, Stream, signals_through
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.levenberg_marquardt import Ended, minimise
from ultraquiet.identify.prediction_error.model_table import modelled, table_of
from ultraquiet.identify.prediction_error.order_choice import told, with_order
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.result import gather
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.identify.prediction_error.structure import Structure
from ultraquiet.identify.result import SIGNIFICANCE, Result, noiseless
from ultraquiet.linalg import portmanteau, prediction
from ultraquiet.linalg.lagged import Lagged
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Status, StatusWord

# Samples of the piece in memory that the search starts from: its estimate is off by some hundred standard deviations of
# an hour's, which a few passes mend. Two pieces are tried before a residual that is not white is blamed on the model.
START_SAMPLES = 32_768
START_PIECES = 2


def identify_long(method: PolynomialSettings, record: LongRecord) -> Result:
    """Return one model per output of a record of any length, driven by all its inputs.

    The same minimum as `method.identify` finds on the record in memory, with one pass over the file an iteration: the
    filters carry their state from block to block, and a trial's residual, gradient and products come of the same pass.
    The past before the record is exact too; it is dropped from the sums once it has decayed to 1e-18 of its peak. The
    search starts from a fit of the most excited piece of `START_SAMPLES`. Clipped readings are not repaired.

    Raises:
        InputError: as `identify`; a NaN in the file.
        StorageError: the file is cut short, damaged or went away.
    """
    if getattr(method, "focus", "auto") == "simulation":
        raise InputError(
            f"{type(method).__name__}: a record on disk is fitted by its one-step error; set focus='prediction', or "
            f"identify a part in memory."
        )
    seen = survey(record)
    size = min(START_SAMPLES, record.samples)
    pieces = [record.part(at, at + size) for at in seen.most_excited(size, START_PIECES)]
    method, words = with_order(method, pieces[:1])
    method.check(pieces[0])
    fits = [_fit_output(method, record, i, seen, pieces) for i in range(len(record.sensors))]
    provenance = Provenance(method.name, asdict(method), parents=(record.hash,), versions=versions())
    model = PolynomialMatrix([[f.model] for f, _ in fits], record.actuators, record.sensors, provenance)
    return told(_gathered(model, [f for f, _ in fits], [p for _, p in fits], seen, provenance), method, words)


def _fit_output(
    method: PolynomialSettings, record: LongRecord, output: int, seen: LongRecordStatistics, pieces: list
) -> tuple[one_fit.Fit, int]:
    data = Stream(record, output, seen)
    structure, nu = method.structure(), len(record.actuators)
    fitted = (method.initial == "estimate", method.offset)
    parameterisation, signals = Parameterisation.alike(structure, nu), signals_through(structure, nu, fitted)
    title = f"identify {method.name} of {record.sensors[output].name}"
    best: Ended[LongRecordPoint] | None = None
    evidence, tried, r = (0.0, 0.0), 0, np.ones(1)
    for piece in pieces:
        tried += 1
        start = method.fit(ChannelData.of(piece, output), record.rate_hz).model
        begin = LongRecordPoint.of(data, signals, title, table_of(parameterisation, start, data.gain))
        minimum = minimise(begin, method.max_iterations, race.TOLERANCE)
        if best is None or minimum.point.criterion < best.point.criterion:
            best = minimum
            evidence, r = _evidence(minimum.point, structure, fitted)
        if best.state == CONVERGED and min(evidence) >= SIGNIFICANCE:
            break
    assert best is not None
    point = best.point
    model = modelled(parameterisation, point.table, data.gain, record.rate_hz, point.criterion * data.output_size**2)
    colored = _colored_products(point, r) if one_fit.is_colored(structure, evidence[0]) else None
    simulation = _simulation(data, model, fitted, title)
    status, silent = one_fit.judged(
        noiseless(point.criterion) or one_fit.verdict(best.state, best.iterations, evidence),
        evidence[1],
        model,
        lambda: _explained(simulation),
        record.samples,
        structure.parameters(nu) + nu * structure.longest + 1,
    )
    fit = one_fit.Fit(
        model,
        _clipping(status, seen, output, record),
        _fit_percent(simulation, data, seen, output),
        model.noise_variance,
        one_fit.covariance(best.normal, point.criterion, structure, data.gain, colored),
        whiteness_p=evidence[0],
        correlation_p=evidence[1],
        iterations=best.iterations,
        starts=tried,
        repaired=0,
        silent=silent,
        past=int(parameterisation.states(*fitted).sum()),
    )
    return fit, data.passes


def _evidence(
    point: LongRecordPoint, structure: Structure, fitted: tuple[bool, bool]
) -> tuple[tuple[float, float], FloatArray]:
    """Return the p-values of `race.residual_tests`, and the residual's autocovariance, from one more pass."""
    data, nu = point.data, point.data.input_size.size
    n = data.record.samples
    lags = min(race.TEST_LAGS, n // 10)
    sums = Lagged(1 + nu, lags)
    still = signals_through(structure, nu, fitted, ())
    data.products(point.table, point.past(), still, point.title, lambda u, _, e: sums.add(np.vstack([e[None], u])))
    r = sums.products(centred=True) / n
    white = portmanteau.ljung_box_of(r[1:, 0, 0] / r[0, 0, 0], n, structure.a + structure.c + structure.d).p_value
    return (white, free_of_inputs_in(r, n, structure.delay > 0)), r[:, 0, 0]


def _colored_products(point: LongRecordPoint, r: FloatArray) -> FloatArray:
    """Return J'RJ as `fit.colored_products` does, from one more pass; r is the residual's autocovariance."""
    from ultraquiet.identify.prediction_error.kernels.normal_equations import reduced

    a, variance = prediction.whitening_of(r)
    G = point.data.products(point.table, point.past(), point.signals, point.title, color=a)
    return variance * reduced(G, point.x.size)[:-1, :-1]


def simulated_fit(record: LongRecord, output: int, model: PolynomialModel, offset: bool = True) -> float:
    """Return the simulated fit of a model on a long record in percent, its past fitted, and a constant if wanted."""
    seen = survey(record)
    data = Stream(record, output, seen)
    return _fit_percent(_simulation(data, model, (True, offset), "simulate"), data, seen, output)


def _simulation(data: Stream, model: PolynomialModel, fitted: tuple[bool, bool], title: str) -> LongRecordPoint | None:
    """Return the output error of a model and what goes with it, None of one that is unstable."""
    nu = data.input_size.size
    lag = min(int(np.flatnonzero(b)[0]) if np.any(b) else 0 for b in model.b)
    order = max(len(model.denominator(j)) for j in range(nu)) - 1
    plant = Structure(0, max(len(b) for b in model.b) - lag, 0, 0, order, lag)
    bare = PolynomialModel(model.b, [model.denominator(j) for j in range(nu)], model.rate_hz)
    if not bare.is_stable():
        return None
    signals = signals_through(plant, nu, fitted, ())
    table = table_of(Parameterisation.alike(plant, nu), bare, data.gain)
    return LongRecordPoint.of(data, signals, title, table, np.zeros(signals.unknown_past))


def _fit_percent(simulation: LongRecordPoint | None, data: Stream, seen: LongRecordStatistics, output: int) -> float:
    """Return the simulated fit in percent: the output-error loss of the model, its past and a constant fitted."""
    if simulation is None:
        return -np.inf
    loss = max(simulation.criterion, 0.0) * data.output_size**2
    return 100.0 * (1.0 - np.sqrt(loss) / float(seen.output_size[output]))


def _explained(simulation: LongRecordPoint | None) -> float:
    """Return `chance.explained` of the whole record, from one more pass: with the past that fits it."""
    if simulation is None:
        return 0.0
    data = simulation.data
    sums = Lagged(2, min(prediction.MEMORY, data.record.samples // 10))
    data.products(
        simulation.table,
        simulation.past(),
        simulation.signals,
        simulation.title,
        lambda _, y, e: sums.add(np.vstack([y, e])),
    )
    return chance.explained_of(sums, 0, 1)


def _clipping(status: Status, seen: LongRecordStatistics, output: int, record: LongRecord) -> Status:
    """Return the verdict, no longer ok when readings stand at the sensor's limits."""
    count = int(seen.clipped[output])
    if count == 0 or not status.ok:
        return status
    return Status(
        StatusWord.NOT_WHITE,
        f"{count} readings of '{record.sensors[output].name}' stand at its limits, and a record on disk is not "
        f"repaired; identify a part of it in memory, or lower the excitation.",
    )


def _gathered(
    model: PolynomialMatrix, fits: list[one_fit.Fit], passes: list[int], seen: LongRecordStatistics, made: Provenance
) -> Result:
    result = gather(model, fits, made)
    return replace(result, details={**result.details, "passes": tuple(passes), "samples": seen.samples})
