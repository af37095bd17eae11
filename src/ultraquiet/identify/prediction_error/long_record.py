"""Prediction-error models of records longer than memory: one pass over the file an iteration."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.files import LongRecord
from ultraquiet.identify.long_record_statistics import LongRecordStatistics, survey
from ultraquiet.identify.prediction_error import fit as one_fit
from ultraquiet.identify.prediction_error.initial_models import Channel
from ultraquiet.identify.prediction_error.structure import (
    ROW_A,
    ROW_C,
    ROW_D,
    ROW_FIRST,
    IntArray,
    Structure,
    b_rows,
    f_rows,
    free_rows,
    reduced,
)
from ultraquiet.identify.result import SIGNIFICANCE, Result
from ultraquiet.linalg import portmanteau
from ultraquiet.linalg.lagged import Lagged
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Status, StatusWord

if TYPE_CHECKING:
    from ultraquiet.identify.polynomial.methods import PolynomialMethod

# Samples of the piece in memory that the search starts from: its estimate is off by some hundred standard deviations of
# an hour's, which a few passes mend. Two pieces are tried before a residual that is not white is blamed on the model.
START_SAMPLES = 32_768
START_PIECES = 2

Watch = Callable[[FloatArray, FloatArray, FloatArray], None]


class Stream:
    """One output of a long record with its inputs, each scaled to unit deviation as it is read."""

    def __init__(self, record: LongRecord, output: int, seen: LongRecordStatistics) -> None:
        self.record = record.pick(outputs=[output])
        self.input_size = seen.input_size
        self.output_size = float(seen.output_size[output])
        self.gain = self.output_size / self.input_size
        self.passes = 0

    def gram(
        self, table: FloatArray, x: FloatArray, shape: "Shape", title: str, watch: Watch | None = None
    ) -> tuple[FloatArray, int]:
        """Return the products of nuisance, gradient and residual columns at (table, x), and the count of the first.

        `watch` is handed inputs, output and residual of every block.
        """
        from ultraquiet.identify.prediction_error import long_record_kernels as kernels

        _, lags, counts = kernels.plan(shape.degree, shape.lag, shape.free, shape.states)
        q, width = int(shape.states.sum()), int(counts.sum())
        head = int(lags.max() + counts.max() + shape.degree.max()) + 1
        nu = self.input_size.size
        work = np.zeros((kernels.rows_needed(len(table)), head + kernels.cell_length(width)))
        alive = shape.states[[*f_rows(nu), ROW_C]] > 0
        peak, done, G = np.zeros(nu + 1), np.zeros(2, np.int64), np.zeros((width, width))
        scale_u, scale_y = 1.0 / self.input_size[:, None], 1.0 / self.output_size
        self.passes += 1
        with task(f"{title}, pass {self.passes}", self.record.samples) as progress:
            for inputs, outputs in self.record.blocks():
                u, y = inputs * scale_u, outputs[0] * scale_y
                e = np.empty(y.size)
                kernels.advance(
                    u, y, table, shape.degree, shape.lag, shape.free, shape.states, x, head, work, alive, peak, done,
                    G, e,
                )  # fmt: skip
                if watch is not None:
                    watch(u, y, e)
                progress.advance(y.size)
        return G, q


@dataclass(frozen=True, eq=False)
class Shape:
    """What of a structure the kernels need: see `structure.Structure`."""

    degree: IntArray
    lag: IntArray
    free: np.ndarray
    states: IntArray

    @classmethod
    def of(cls, structure: Structure, nu: int, estimate: bool, offset: bool) -> "Shape":
        """Return the shape with every row free."""
        free = free_rows(nu, [ROW_A, *b_rows(nu), *f_rows(nu), ROW_C, ROW_D])
        return cls(structure.degree(nu), structure.lag(nu), free, structure.states(nu, estimate, offset))

    @property
    def fixed(self) -> "Shape":
        """The same with no row free: a pass that only measures."""
        return replace(self, free=np.zeros_like(self.free))


@dataclass(frozen=True, eq=False)
class Place:
    """A point of the search: the table, the unknown past, their products, and the loss with the best past."""

    table: FloatArray
    x: FloatArray
    G: FloatArray
    q: int
    normal: FloatArray
    loss: float


def identify_long(method: "PolynomialMethod", record: LongRecord) -> Result:
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
    method.check(pieces[0])
    fits = [_fit_output(method, record, i, seen, pieces) for i in range(len(record.sensors))]
    made = Provenance(method.name, asdict(method), parents=(record.hash,), versions=versions())
    model = PolynomialMatrix([[f.model] for f, _ in fits], record.actuators, record.sensors, made)
    return _gathered(model, [f for f, _ in fits], [p for _, p in fits], seen, made)


def _fit_output(
    method: "PolynomialMethod", record: LongRecord, output: int, seen: LongRecordStatistics, pieces: list
) -> tuple[one_fit.Fit, int]:
    data = Stream(record, output, seen)
    structure, nu = method.structure(), len(record.actuators)
    shape = Shape.of(structure, nu, method.initial == "estimate", method.offset)
    title = f"identify {method.name} of {record.sensors[output].name}"
    best: tuple[Place, int, int] | None = None
    evidence, tried = (0.0, 0.0), 0
    for piece in pieces:
        tried += 1
        start = method.fit(Channel.of(piece, output), record.rate_hz).model
        place, iterations, state = _search(data, shape, _table(start, structure, data.gain), method, title)
        if best is None or place.loss < best[0].loss:
            best = (place, iterations, state)
            evidence = _evidence(data, place, shape, structure, title)
        if best[2] == one_fit.CONVERGED and min(evidence) >= SIGNIFICANCE:
            break
    assert best is not None
    place, iterations, state = best
    model = _model(place, structure, data, record.rate_hz)
    fit = one_fit.Fit(
        model,
        _clipping(one_fit.verdict(state, iterations, evidence), seen, output, record),
        _simulated_fit(data, model, seen, output, (method.initial == "estimate", method.offset), title),
        model.noise_variance,
        one_fit.covariance(place.normal, place.loss, structure, data.gain),
        whiteness_p=evidence[0],
        correlation_p=evidence[1],
        iterations=iterations,
        starts=tried,
        repaired=0,
    )
    return fit, data.passes


def _search(
    data: Stream, shape: Shape, start: FloatArray, method: "PolynomialMethod", title: str
) -> tuple[Place, int, int]:
    """Minimise as `kernels.search`, one pass a trial; return the place, the iterations and the state reached."""
    from ultraquiet.identify.prediction_error import kernels
    from ultraquiet.identify.prediction_error.long_record_kernels import past

    n = data.record.samples
    place = _place(data, shape, start, np.zeros(int(shape.states.sum())), title)
    damping, small, iterations = 1e-3, 0, 0
    while True:
        if not np.isfinite(place.loss):
            return place, iterations, one_fit.STUCK
        if kernels.damped_step(place.normal, 0.0)[1] <= one_fit.TOLERANCE * place.loss:
            return place, iterations, one_fit.CONVERGED
        if small >= kernels.STALLED_STEPS:
            return place, iterations, one_fit.CONVERGED
        if iterations >= method.max_iterations:
            return place, iterations, 0
        for _ in range(kernels.INNER_TRIES):
            step, promised = kernels.damped_step(place.normal, damping)
            trial = kernels.stepped(place.table, shape.degree, shape.free, step)
            if kernels.admissible(trial, shape.degree):
                there = _place(data, shape, trial, place.x + past(place.G, place.q, step), title)
                if there.loss < place.loss:
                    gain = n * (place.loss - there.loss)
                    damping *= 0.1 if gain > 0.75 * promised else (0.5 if gain > 0.25 * promised else 2.0)
                    damping = max(1e-12, damping)
                    small = small + 1 if gain <= one_fit.TOLERANCE * place.loss else 0
                    place = there
                    break
            damping = max(damping, 1e-9) * 6.0
        else:
            return place, iterations, one_fit.STUCK
        iterations += 1


def _place(data: Stream, shape: Shape, table: FloatArray, x: FloatArray, title: str) -> Place:
    from ultraquiet.identify.prediction_error import kernels

    G, q = data.gram(table, x, shape, title)
    S = kernels.reduced(G, q)
    return Place(table, x, G, q, S, float(S[-1, -1]) / data.record.samples)


def _evidence(data: Stream, place: Place, shape: Shape, structure: Structure, title: str) -> tuple[float, float]:
    """Return the p-values of `fit.residual_tests` from one more pass."""
    from ultraquiet.identify.prediction_error.long_record_kernels import past

    n = data.record.samples
    lags = min(one_fit.TEST_LAGS, n // 10)
    sums = Lagged(1 + data.input_size.size, lags)
    x = place.x + past(place.G, place.q, np.zeros(len(place.normal) - 1))
    data.gram(place.table, x, shape.fixed, title, lambda u, _, e: sums.add(np.vstack([e[None], u])))
    r = sums.products(centred=True) / n
    white = portmanteau.ljung_box_of(r[1:, 0, 0] / r[0, 0, 0], n, structure.a + structure.c + structure.d).p_value
    least = min(
        portmanteau.cross_correlation_of(r[:, j, 0], r[:, j, j], r[:1, 0, 0], n).p_value for j in range(1, r.shape[1])
    )
    return white, 1.0 - (1.0 - least) ** (r.shape[1] - 1)


def simulated_fit(record: LongRecord, output: int, model: PolynomialModel, offset: bool = True) -> float:
    """Return the simulated fit of a model on a long record in percent, its past fitted, and a constant if wanted."""
    seen = survey(record)
    return _simulated_fit(Stream(record, output, seen), model, seen, output, (True, offset), "simulate")


def _simulated_fit(
    data: Stream, model: PolynomialModel, seen: LongRecordStatistics, output: int, fitted: tuple[bool, bool], title: str
) -> float:
    """Return the simulated fit in percent: the output-error loss of the model, its past and a constant fitted."""
    from ultraquiet.identify.prediction_error import kernels

    nu = data.input_size.size
    lag = min(int(np.flatnonzero(b)[0]) if np.any(b) else 0 for b in model.b)
    order = max(len(model.denominator(j)) for j in range(nu)) - 1
    plant = Structure(0, max(len(b) for b in model.b) - lag, 0, 0, order, lag)
    bare = PolynomialModel(model.b, [model.denominator(j) for j in range(nu)], model.rate_hz)
    if not bare.is_stable():
        return -np.inf
    shape = Shape.of(plant, nu, *fitted).fixed
    table = _table(bare, plant, data.gain)
    G, q = data.gram(table, np.zeros(int(shape.states.sum())), shape, title)
    loss = float(kernels.reduced(G, q)[-1, -1]) / data.record.samples * data.output_size**2
    return 100.0 * (1.0 - np.sqrt(max(loss, 0.0)) / float(seen.output_size[output]))


def _table(model: PolynomialModel, structure: Structure, gain: FloatArray) -> FloatArray:
    """Return the kernels' table of a model in the record's units, scaled to unit deviations."""
    nu = len(model.b)
    degree, lag = structure.degree(nu), structure.lag(nu)
    table = structure.empty(nu)
    for row, p in ((ROW_A, model.a), (ROW_C, model.c), (ROW_D, model.d)):
        table[row, : p.size] = p
    for j in range(nu):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        held = model.b[j][lag[b] : lag[b] + degree[b]] / gain[j]
        table[b, : held.size] = held
        table[f, : model.f[j].size] = model.f[j]
    return table


def _model(place: Place, structure: Structure, data: Stream, rate_hz: float) -> PolynomialModel:
    """Return the table's model in the units of the record."""
    table, nu = place.table, data.input_size.size
    degree, lag = structure.degree(nu), structure.lag(nu)
    return PolynomialModel(
        [np.concatenate([np.zeros(lag[r]), data.gain[j] * table[r, : degree[r]]]) for j, r in enumerate(b_rows(nu))],
        [one_fit.settled(reduced(table[r], degree[r])) for r in f_rows(nu)],
        rate_hz,
        reduced(table[ROW_A], degree[ROW_A]),
        one_fit.settled(reduced(table[ROW_C], degree[ROW_C])),
        one_fit.settled(reduced(table[ROW_D], degree[ROW_D])),
        noise_variance=place.loss * data.output_size**2,
    )


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
    from ultraquiet.identify.polynomial.methods import gather

    held = gather(model, fits, made)
    return replace(held, details={**held.details, "passes": tuple(passes), "samples": seen.samples})
