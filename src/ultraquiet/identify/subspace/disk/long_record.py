"""Subspace models of records longer than memory: a few passes over the file, whatever its length."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.files import LongRecord
from ultraquiet.identify import chance
from ultraquiet.identify.long_record_statistics import LongRecordStatistics, survey
from ultraquiet.identify.record_checks import parameters_of, usable
from ultraquiet.identify.result import SIGNIFICANCE, Result, noiseless, worst
from ultraquiet.identify.subspace import (
    evidence,
    fit,
    gauss_newton,
    hankel,
    missing_modes,
    modal_least_squares,
    order_selection,
    pole_search,
    unexcited,
)
from ultraquiet.identify.subspace.modal_least_squares import FilterBank, Modes, alternate
from ultraquiet.identify.subspace.settings import SubspaceSettings
from ultraquiet.identify.subspace.start import ROUNDS, Horizon, SubspaceStart
from ultraquiet.linalg import balance, portmanteau, prediction
from ultraquiet.linalg.lagged import Lagged
from ultraquiet.values import Record, Status, StatusWord

# Samples from the record's beginning that the noise gain is fitted to: some hundred for each of its numbers.
NOISE_SAMPLES = 65_536
REFINED_SAMPLES = 65_536  # the most excited stretch, on which a search moves the poles
PIECE_SAMPLES = 32_768  # the most excited stretch, on which an order is chosen and copies among inputs are found


@dataclass(frozen=True, eq=False)
class ScaledStream:
    """A long record whose blocks come scaled as `fit.Scaled` has them."""

    record: LongRecord
    statistics: LongRecordStatistics
    added: FloatArray | None = None  # to the inputs, over and over: see `unexcited.topped_up`
    told: tuple[int, ...] = ()  # parameters by the lines of each input, as they are known once topped up

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.record.samples

    def blocks(self, title: str) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield scaled inputs and outputs, telling progress."""
        with task(title, self.samples) as progress:
            for u, y in self.record.blocks():
                yield self._scaled(u, y)
                progress.advance(u.shape[1])

    def heard(self, title: str) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the blocks, inputs topped up where they are silent throughout the record."""
        at = 0
        for u, y in self.blocks(title):
            turn = np.arange(at, at + u.shape[1])
            at += u.shape[1]
            yield u if self.added is None else u + self.added[:, turn % self.added.shape[1]], y

    def topped_up(self) -> "ScaledStream":
        """Return the stream with what its silent bands ask for, from the mean power over stretches of the whole.

        The noise repeats after a stretch: its lines are those that were looked at, and none is the inputs'.
        """
        size = min(PIECE_SAMPLES, self.samples)
        powers = []
        with task("subspace: silent bands", self.samples) as progress:
            for start in sorted({*range(0, self.samples - size + 1, size), self.samples - size}):
                part = self.scaled(self.record.part(start, start + size))
                own = np.abs(np.fft.rfft(part.centred_u, axis=1)) ** 2
                powers.append((unexcited.power(part.u), own, unexcited.power(part.y)))
                progress.advance(size)
        asked, own, heard = (np.mean(np.stack(each), axis=0) for each in zip(*powers, strict=True))
        bands = unexcited.bands_of(asked)
        added = unexcited.noise(own, heard, bands, size) if bands else None
        return replace(self, added=added, told=tuple(parameters_of(power) for power in asked))

    def first(self, samples: int) -> fit.Scaled:
        """Return the beginning of the record in memory."""
        return self.scaled(self.record.part(0, min(samples, self.samples)))

    def scaled(self, part: Record) -> fit.Scaled:
        """Return a part in memory in the scale of the whole."""
        u, y = self._scaled(part.inputs, part.outputs)
        return fit.Scaled(u, y, self.statistics.input_size[:, None], self.statistics.output_size[:, None])

    @property
    def input_level(self) -> FloatArray:
        """Means of the scaled inputs, `(nu, 1)`."""
        s = self.statistics
        return ((s.input_mean - fit.excess(s.input_mean, s.input_size)) / s.input_size)[:, None]

    def _scaled(self, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        s = self.statistics
        u = u - fit.excess(s.input_mean, s.input_size)[:, None]
        return u / s.input_size[:, None], (y - s.output_mean[:, None]) / s.output_size[:, None]


def identify_long_subspace(settings: SubspaceSettings, record: LongRecord) -> Result:
    """Return the state-space model of all channels of a record of any length.

    One pass for the sizes, one for bands without excitation (`unexcited`), one for the products of all lags (they hold
    the Hankel matrix of every horizon), one for each horizon's least squares in modal coordinates, one for the
    evidence. The model is that of `Subspace.identify` on the record in memory, but for the noise gain, which is
    fitted to the first `NOISE_SAMPLES`. With `refine`, the search moves the poles on the most excited
    `REFINED_SAMPLES`; all else is then fitted to the whole record again.

    Raises:
        InputError: as `Subspace.identify`; a search for the one-step error (`focus="prediction"`).
        StorageError: the file is cut short, damaged or went away.
    """
    if settings.refine and settings.focus == "prediction":
        raise InputError(
            "Subspace: a record on disk is not refined for its one-step error; set focus='simulation', or refine on a "
            "part in memory."
        )
    statistics = survey(record)
    piece = _most_excited(record, statistics, PIECE_SAMPLES)
    settings.horizons(piece, settings.given_order or 1)
    usable("Subspace", piece, settings.given_order or 1, 0)
    evidence.independent("Subspace", piece)
    order = order_selection.chosen(settings, piece) if settings.given_order is None else settings.given_order
    data = ScaledStream(record, statistics).topped_up()
    allowing = settings.allowing_feedthrough()
    best = min(_starts(allowing, data, order), key=lambda s: s.loss)
    settings, best = settings.of_start(best if settings.refine else _replenished(allowing, data, best))
    modes, steps, converged = _finished(settings, data, best)
    early = data.first(NOISE_SAMPLES)
    system = fit.system(modes)
    system = replace(system, K=fit.noise_gain(system, best.innovations(early), early))
    provenance = Provenance(settings.name, asdict(settings), parents=(record.hash,), versions=versions())
    details = {
        "horizon": best.horizon.rows,
        "order": len(system.A),
        "singular_values": best.horizon.values,
        "samples": data.samples,
    }
    return _judged(system, data, (steps, converged), provenance, details)


def _most_excited(record: LongRecord, statistics: LongRecordStatistics, samples: int) -> Record:
    size = min(samples, record.samples)
    at = statistics.most_excited(size, 1)[0]
    return record.part(at, at + size)


def _starts(settings: SubspaceSettings, data: ScaledStream, order: int) -> Iterator[SubspaceStart]:
    """Yield what each horizon gives."""
    nu, ny = len(data.record.actuators), len(data.record.sensors)
    horizons = settings.horizons(data.record, order)
    sums = Lagged(nu + ny, 2 * max(horizons))
    for u, y in data.heard("subspace: products at all lags"):
        sums.add(np.vstack([u - data.input_level, y]))
    products = sums.products()
    for rows in horizons:
        G = hankel_gram(products, sums, 2 * rows)
        G = hankel.without_levels(G, sums.mean * sums.samples, sums.head, sums.tail[:, -2 * rows :], data.samples)
        factor = hankel.factored(G, nu, ny, rows, data.samples)
        bank_at = partial(_bank, settings, data, f"subspace: least squares at horizon {rows}")
        start = SubspaceStart.of(Horizon.of(factor, settings.weight), order, bank_at)
        yield start.pruned() if settings.given_order is None else start


def _bank(settings: SubspaceSettings, data: ScaledStream, title: str, poles: ComplexArray) -> FilterBank:
    from ultraquiet.identify.subspace.disk.long_record_bank import StreamedBank

    shape = (len(data.record.actuators), len(data.record.sensors), data.samples)
    return StreamedBank(poles, data.heard(title), shape, bool(settings.feedthrough), settings.offset)


def _stretch(data: ScaledStream) -> fit.Scaled:
    """Return the most excited stretch in memory, topped up as the whole is."""
    piece = data.scaled(_most_excited(data.record, data.statistics, REFINED_SAMPLES))
    return unexcited.topped_up(piece, unexcited.silent_bands(piece.u)) if data.added is not None else piece


def _replenished(settings: SubspaceSettings, data: ScaledStream, best: SubspaceStart) -> SubspaceStart:
    """Return the start, faint modes replaced by those that its error on one stretch shows, where that serves all."""
    sought = pole_search.sought(settings, _stretch(data))
    bank, modes = sought.fitted(fit.system(best.modes))
    _, other = missing_modes.replenished(bank, modes, sought)
    if np.array_equal(other.poles, modes.poles):
        return best
    bank = _bank(settings, data, "subspace: least squares with modes that were missed", other.poles)
    modes = alternate(bank, other.c, missing_modes.ROUNDS)
    loss = modal_least_squares.cost(bank, modes)
    return replace(best, loss=loss, bank=bank, modes=modes) if loss < best.loss else best


def _finished(settings: SubspaceSettings, data: ScaledStream, best: SubspaceStart) -> tuple[Modes, int, bool]:
    """Return the modes after the last rounds, poles refined when asked for, the search's steps and its end."""
    if not settings.refine:
        return best.settled(), 0, True
    refined, steps, converged = pole_search.refined(settings, _stretch(data), best.modes)
    poles, directions, _ = fit.modes_of(refined.A, refined.C)
    bank = _bank(settings, data, "subspace: least squares at the refined poles", poles)
    modes = alternate(bank, directions, ROUNDS)
    better = modal_least_squares.cost(bank, modes) < modal_least_squares.cost(best.bank, best.modes)
    return modes if better else best.modes, steps, converged


def hankel_gram(products: FloatArray, sums: Lagged, rows: int) -> FloatArray:
    """Return `kernels.hankel_gram` of the whole record from its lagged products and its two ends.

    Shifting both factors by one sample changes a product by its two end terms, so only the first block row is summed.
    """
    m = products.shape[1]
    G = np.empty((rows, rows, m, m))
    # tail[:, -k] is the k-th sample from the end; the products reach to the end, the first block row does not.
    head, tail = sums.head, sums.tail[:, -rows:]
    for j in range(rows):
        extra = rows - 1 - j
        ends = tail[:, 1 : 1 + extra] @ tail[:, 1 + j : 1 + j + extra].T if extra else np.zeros((m, m))
        G[0, j] = products[j] - ends
        G[j, 0] = G[0, j].T
    for i in range(1, rows):
        later = np.einsum("a,jb->jab", tail[:, i], tail[:, i:].T)
        sooner = np.einsum("a,jb->jab", head[:, i - 1], head[:, i - 1 : rows - 1].T)
        G[i, i:] = G[i - 1, i - 1 : rows - 1] + later - sooner
        G[i:, i] = np.swapaxes(G[i, i:], 1, 2)
    return G.transpose(0, 2, 1, 3).reshape(rows * m, rows * m)


def _judged(
    system: fit.System, data: ScaledStream, search: tuple[int, bool], provenance: Provenance, details: dict[str, Any]
) -> Result:
    """Return the result of a system in scaled units, its evidence from one more pass."""
    ny, nu = system.D.shape
    lags = min(evidence.TEST_LAGS, data.samples // 10)
    memory = min(evidence.RESIDUAL_LAGS, data.samples // 10)
    simulated, predicted = Lagged(ny + nu, lags + memory), Lagged(ny, lags)
    heard = [Lagged(2, min(prediction.MEMORY, data.samples // 10)) for _ in range(ny)]
    seen = np.zeros((len(system.A) + nu + 1,) * 2)
    for u, y, v, e, x in _errors(system, data):
        rows = np.vstack([x, u, np.ones((1, u.shape[1]))])
        seen += rows @ rows.T
        simulated.add(np.vstack([v, u]))
        predicted.add(e)
        for sums, own, miss in zip(heard, y, v, strict=True):
            sums.add(np.stack([own, miss]))
    n = data.samples
    r, white = simulated.products(centred=True) / n, predicted.products(centred=True)
    free = [_free(r, i, ny, lags, memory, n) for i in range(ny)]
    spread = predicted.products()[0] / n
    squares = np.diag(simulated.products()[0])[:ny] / n
    numbers = chance.numbers_of(len(system.A), nu)
    spare = _spare_modes(system, seen, squares, n)
    beyond = evidence.too_many(spare, len(system.A))
    statuses = [
        chance.unless_silent(
            _verdict(p, *search, noiseless(float(squares[i])) or beyond),
            chance.explained_of(heard[i], 0, 1),
            n,
            numbers,
            p,
        )
        for i, p in enumerate(free)
    ]
    statuses = evidence.unless_a_guess(statuses, data.told, len(system.A))
    at_limits = zip(statuses, data.statistics.clipped.tolist(), data.record.sensors, strict=True)
    statuses = [evidence.unless_clipped(*each, what="a part of it in memory") for each in at_limits]
    whiteness_p = [portmanteau.ljung_box_of(white[1:, i, i] / white[0, i, i], n).p_value for i in range(ny)]
    # Any errors of this covariance will do: the model keeps no more of them.
    like = np.linalg.cholesky(gauss_newton.propped(spread) + np.finfo(float).tiny * np.eye(ny)) * np.sqrt(ny)
    model = evidence.modelled(system, like, data.record.part(0, 1), data.first(1), provenance)
    return Result(
        model=model,
        status=worst(statuses),
        fit_percent=100.0 * (1.0 - np.sqrt(squares)),
        loss=np.diag(spread) * data.statistics.output_size**2,
        covariance=np.full((ny, 0, 0), np.nan),
        whiteness_p=np.array(whiteness_p),
        correlation_p=np.array(free),
        iterations=np.full(ny, search[0], dtype=np.int64),
        statuses=tuple(statuses),
        provenance=provenance,
        details={**details, "spare_modes": spare},
        past=len(system.A) / ny + 1,
        no_band="no band: the record was read in blocks; identify a part of it in memory with refine=True for one.",
    )


def _spare_modes(system: fit.System, seen: FloatArray, squares: FloatArray, n: int) -> int:
    """Return `evidence.spare_modes` from the products `seen` of states, inputs and one over the whole record."""
    nu, order = system.B.shape[1], len(system.A)
    form = balance.modal(system.A, np.hstack([system.B, system.K, system.x0[:, None]]), system.C)
    to_modes = np.eye(order + nu + 1)
    to_modes[:order, :order] = form.inverse
    return evidence.spare_of(form, to_modes @ seen @ to_modes.T, squares, nu, n)


def _errors(system: fit.System, data: ScaledStream) -> Iterator[tuple[FloatArray, ...]]:
    """Yield inputs, outputs, simulated and one-step errors, and the states of the former, block by block."""
    from ultraquiet.identify.subspace.disk.long_record_bank import simulated

    inner = np.ascontiguousarray(system.A - system.K @ system.C)
    A, into = np.ascontiguousarray(system.A), system.B - system.K @ system.D
    x, z = system.x0.copy(), system.x0.copy()
    for u, y in data.blocks("subspace: evidence"):
        v = y - system.constant[:, None] - system.D @ u
        states = np.empty((len(A), u.shape[1]))
        simulated(A, system.B @ u, x, states)
        miss = v - system.C @ states
        inner_states = np.empty_like(states)
        simulated(inner, into @ u + system.K @ (y - system.constant[:, None]), z, inner_states)
        yield u, y, miss, v - system.C @ inner_states, states


def _free(r: FloatArray, i: int, ny: int, lags: int, memory: int, n: int) -> float:
    """Return the p-value that the simulated error of output i is free of all inputs."""
    return portmanteau.sidak(
        portmanteau.cross_correlation_of(r[: lags + 1, j, i], r[:, j, j], r[: memory + 1, i, i], n).p_value
        for j in range(ny, r.shape[1])
    )


def _verdict(p: float, steps: int, converged: bool, known: Status | None) -> Status:
    """Return the verdict on one output; what is `known` without a test stands."""
    if known is not None:
        return known
    if not converged:
        return Status(StatusWord.NOT_CONVERGED, f"The search ended away from a minimum after {steps} steps.")
    if p < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The simulated error still holds something of the inputs ({p_in_words(p)}): the order or the horizon "
            "leaves part of the record unexplained.",
        )
    return Status(StatusWord.OK, f"The simulated error is free of the inputs ({p_in_words(p)}).")
