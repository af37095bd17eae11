"""Where the search begins. Starts decide success: at 3.5 kHz a search from a poor one ends in a poor minimum."""

from collections.abc import Hashable, Iterator
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.in_memory import InMemory
from ultraquiet.identify.prediction_error.model_table import table_of
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.signals import signals_of
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, Structure, b_rows, f_rows, free_rows
from ultraquiet.identify.subspace import hankel
from ultraquiet.linalg import portmanteau, realize
from ultraquiet.linalg.lagged import products_of_shifts
from ultraquiet.linalg.polynomial_roots import mirrored_inside, monic_from_roots, stabilised
from ultraquiet.linalg.prediction import repaired
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace

# A start's poles and zeros are drawn inside this radius: a search that begins on the circle cannot leave it.
RADIUS = 0.9995
NOISE_RADIUS = 0.998
START_RADIUS = 1.0 - 1e-5  # for a model that is given: the search itself comes as near as 1e-6
LONG_MEMORY = 30  # order of the autoregression that stands in for the noise filter's inverse
LONG_RIDGE = 1e-12  # share of v's size: below it normal equations of shifts hold no digit
HANNAN_ROUNDS = 2


class ChannelData:
    """One output with its inputs, each scaled to unit deviation; keeps what all structures and orders share."""

    def __init__(self, u: FloatArray, y: FloatArray, low: float = -np.inf, high: float = np.inf) -> None:
        self.recorded, self.low, self.high = y, low, high
        self.input_size = u.std(axis=1)
        self.output_size = float(y.std())
        self.u = np.ascontiguousarray(u / self.input_size[:, None])
        self.y = y / self.output_size
        self.gain = self.output_size / self.input_size
        self._subspaces: dict[int, tuple[FloatArray, FloatArray] | None] = {}
        self.searched: dict[Hashable, Any] = {}
        self.numerators: dict[Hashable, FloatArray] = {}  # of the plants that starts begin with, by their poles
        self._tests: dict[tuple[int, bool], portmanteau.InputTests] = {}
        self.start: PolynomialModel | None = None

    @classmethod
    def of(cls, record: Record, output: int, start: PolynomialModel | None = None) -> "ChannelData":
        """Return an output of a record with its sensor's limits, and the model that searches are to begin from."""
        sensor = record.sensors[output]
        channel = cls(record.inputs, record.outputs[output], sensor.low, sensor.high)
        channel.start = start
        return channel

    @property
    def clipped(self) -> int:
        """How many readings stand at the sensor's limits."""
        return int(np.count_nonzero((self.recorded >= self.high) | (self.recorded <= self.low)))

    def repaired(self, model: FloatArray) -> "ChannelData":
        """Return the channel with its clipped readings replaced by a model's output, in output units."""
        other = copy(self)
        other.searched, other.numerators = {}, {}
        other.y = repaired(self.recorded, model, self.low, self.high) / self.output_size
        return other

    @cached_property
    def centred(self) -> tuple[FloatArray, FloatArray]:
        """Inputs and output without their means."""
        return self.u - self.u.mean(axis=1, keepdims=True), (self.y - self.y.mean())[None]

    def tests_of_inputs(self, lags: int, delayed: bool = False) -> portmanteau.InputTests:
        """Return the tests that residuals hold nothing of the inputs within so many lags, their own sample's or not."""
        if (lags, delayed) not in self._tests:
            self._tests[lags, delayed] = portmanteau.InputTests(self.u, lags, delayed)
        return self._tests[lags, delayed]

    def poles(self, order: int, rows: int) -> ComplexArray | None:
        """Return the poles of the subspace model with `rows` block rows; None when the record does not carry them."""
        if rows not in self._subspaces:
            self._subspaces[rows] = self._subspace(rows)
        subspace = self._subspaces[rows]
        if subspace is None or order >= rows:
            return None
        return hankel.poles(*subspace, order)

    def _subspace(self, rows: int) -> tuple[FloatArray, FloatArray] | None:
        # Fewer columns than three times the rows of the Hankel matrix make its projections noise.
        if self.y.size < 3 * 2 * rows * (self.u.shape[0] + 1):
            return None
        try:
            return hankel.observability(*self.centred, rows)
        except np.linalg.LinAlgError:
            return None


def starting_models(
    start: PolynomialMatrix | StateSpace | None, outputs: int, columns: int, rate_hz: float
) -> list[list[PolynomialModel | None]]:
    """Return the model each channel's search begins from, `(outputs, columns)`; None everywhere without a start."""
    if start is None:
        return [[None] * columns for _ in range(outputs)]
    if isinstance(start, StateSpace):
        raise InputError("start: a state space has no polynomials to begin from; give the model of a polynomial fit.")
    if len(start.rows) != outputs or any(len(row) != columns for row in start.rows):
        raise InputError(
            f"start: the fit has {outputs} x {columns} models, the start {len(start.rows)} x {len(start.rows[0])}."
        )
    if start.rate_hz != rate_hz:
        raise InputError(f"start: the model is sampled at {start.rate_hz:g} Hz, the record at {rate_hz:g} Hz.")
    return [list(row) for row in start.rows]


def start_table(data: ChannelData, structure: Structure, model: PolynomialModel) -> FloatArray:
    """Return the kernels' table of a model that a search can begin from, in the channel's own units.

    A structure without noise polynomials takes the plant alone.

    Raises:
        InputError: the model has other inputs, a polynomial the structure lacks, or more coefficients.
    """
    nu = data.u.shape[0]
    parameterisation = Parameterisation.alike(structure, nu)
    degree = parameterisation.degree()
    if len(model.b) != nu:
        raise InputError(f"start: the model has {len(model.b)} inputs, the record {nu}.")
    noise = [(row, p) for row, p in ((ROW_C, model.c), (ROW_D, model.d)) if degree[row] > 0]
    table = table_of(parameterisation, model, data.gain)
    for row, p in [(ROW_A, model.a), *noise, *zip(f_rows(nu), model.f, strict=True)]:
        order = np.trim_zeros(p, "b").size - 1
        if order > degree[row]:
            raise InputError(f"start: the model has a polynomial of order {order}, the fit takes {degree[row]}.")
        table[row, : order + 1] = p[: order + 1] if row == ROW_A else _movable(p[: order + 1])
    return table


def _movable(p: FloatArray) -> FloatArray:
    """Return p, its roots drawn in if any stands so near to the circle that no step could leave it."""
    return p if np.all(np.abs(np.roots(p)) <= START_RADIUS) else stabilised(p, START_RADIUS)


def starting_tables(data: ChannelData, structure: Structure, horizons: tuple[int, ...]) -> Iterator[FloatArray]:
    """Yield tables to search from, the most promising first."""
    if structure.f == 0:
        alone = [_from_poles(data, structure, np.ones(1))]  # no poles at all: B is linear, C and D follow
        yield from _equation_error(data, structure, horizons) if structure.a else alone
        return
    fallback = True
    for rows in horizons:
        poles = data.poles(structure.f, rows)
        if poles is None:
            continue
        fallback = False
        yield _from_poles(data, structure, monic_from_roots(mirrored_inside(poles, RADIUS)))
    if fallback:
        table = _least_squares(data, Structure(structure.f, structure.b, 0, 0, 0, structure.delay))
        f = stabilised(table[ROW_A, : structure.f + 1], RADIUS)
        yield _from_poles(data, structure, f)


def _equation_error(data: ChannelData, structure: Structure, horizons: tuple[int, ...]) -> Iterator[FloatArray]:
    """Yield starts of ARX and ARMAX: least squares, and the subspace poles as A with C = A (noise at the output)."""
    plain = _least_squares(data, Structure(structure.a, structure.b, 0, 0, 0, structure.delay))
    nu = data.u.shape[0]
    if structure.c == 0:
        yield plain
        return
    output_error = Structure(0, structure.b, 0, 0, structure.a, structure.delay)
    for rows in horizons:
        poles = data.poles(structure.a, rows)
        if poles is None:
            continue
        a = monic_from_roots(mirrored_inside(poles, RADIUS))
        simulated = _from_poles(data, output_error, a)
        table = Parameterisation.alike(structure, nu).empty()
        table[ROW_A, : structure.a + 1] = a
        table[b_rows(nu), : structure.b] = simulated[b_rows(nu), : structure.b]
        c = stabilised(a, NOISE_RADIUS)[: structure.c + 1]
        table[ROW_C, : c.size] = stabilised(c, NOISE_RADIUS)
        yield table
    table = Parameterisation.alike(structure, nu).empty()
    table[:, : plain.shape[1]] = plain[:, : table.shape[1]]
    yield table


def _least_squares(data: ChannelData, structure: Structure) -> FloatArray:
    """Return A and B of the equation-error model: linear, so one undamped step is the whole search."""
    nu = data.u.shape[0]
    rows = free_rows(nu, [ROW_A, *b_rows(nu)])
    parameterisation = Parameterisation.alike(structure, nu)
    signals = signals_of(parameterisation, rows, parameterisation.states(True, True))
    accumulator = InMemory(data.u, data.y, signals)
    return accumulator.search(parameterisation.empty(), LINEAR_STEPS, LINEAR_TOLERANCE, UNDAMPED).table


LINEAR_STEPS = 8  # a linear problem is solved by one undamped step; others only clear what rounding left of it
LINEAR_TOLERANCE = 1e-6
UNDAMPED = 0.0


def enlarged_tables(
    data: ChannelData, structure: Structure, table: FloatArray
) -> tuple[Structure, list[FloatArray]] | None:
    """Return a structure whose plant has a mode more, and tables where it is the loudest that rings in the noise.

    The noise begins anew in one, and stays as it is in the other. None where it rings nowhere.
    """
    modes = noise_modes(table, structure)
    if not modes.size:
        return None
    mode = monic_from_roots(mirrored_inside(np.array([modes[0], modes[0].conjugate()]), RADIUS))
    larger = replace(structure, b=structure.b + 2, f=structure.f + 2)
    f = [np.convolve(table[row, : structure.f + 1], mode) for row in f_rows(data.u.shape[0])]
    anew = _from_poles(data, larger, np.array(f))
    return larger, [anew, _with_noise_of(anew, table, structure)]


def noise_modes(table: FloatArray, structure: Structure) -> ComplexArray:
    """Return the poles, loudest first, with which the noise model of a table rings."""
    return portmanteau.noise_modes(table[ROW_C, : structure.c + 1], table[ROW_D, : structure.d + 1])


def _with_noise_of(table: FloatArray, other: FloatArray, structure: Structure) -> FloatArray:
    table = table.copy()
    for row, order in ((ROW_C, structure.c), (ROW_D, structure.d)):
        table[row, : order + 1] = other[row, : order + 1]
    return table


def with_noise_anew(data: ChannelData, structure: Structure, table: FloatArray) -> FloatArray:
    """Return a table with the poles of another's plant, B, C and D as a search begins with."""
    return _from_poles(data, structure, np.array([table[row, : structure.f + 1] for row in f_rows(data.u.shape[0])]))


def smaller_tables(data: ChannelData, structure: Structure, larger: FloatArray) -> Iterator[FloatArray]:
    """Yield tables of a structure from that of a plant with two poles more, one for each two that may be left out.

    Inputs have poles of their own, in the order of frequency: of each those at the same place go. The noise stays.
    """
    nu = data.u.shape[0]
    roots = [realize.roots(larger[row, : structure.f + 3]) for row in f_rows(nu)]
    twos = [_twos(z) for z in roots]
    for place in range(min(len(each) for each in twos)):
        kept = [np.delete(z, each[place]) for z, each in zip(roots, twos, strict=True)]
        f = np.array([monic_from_roots(mirrored_inside(z, RADIUS)) for z in kept])
        yield _with_noise_of(_from_poles(data, structure, f), larger, structure)


def _twos(poles: ComplexArray) -> list[list[int]]:
    """Return the places of two poles that a real polynomial can do without: complex pairs, then real ones."""
    upper = sorted(np.flatnonzero(poles.imag > 0), key=lambda k: float(np.angle(poles[k])))
    pairs = [[int(k), int(np.argmin(np.abs(poles - poles[k].conjugate())))] for k in upper]
    return pairs + [[int(j), int(k)] for j, k in combinations(np.flatnonzero(poles.imag == 0), 2)]


def _from_poles(data: ChannelData, structure: Structure, f: FloatArray) -> FloatArray:
    """Return a table with the given F, one for all inputs or a row for each.

    B by least squares on the simulated output, C and D from what remains.
    """
    nu = data.u.shape[0]
    table = Parameterisation.alike(structure, nu).empty()
    table[f_rows(nu), : f.shape[-1]] = f
    plant = Structure(0, structure.b, 0, 0, structure.f, structure.delay)
    parameterisation = Parameterisation.alike(plant, nu)
    signals = signals_of(parameterisation, free_rows(nu, b_rows(nu)), parameterisation.states(True, True))
    accumulator = InMemory(data.u, data.y, signals)
    # Output error, Box-Jenkins and ARMAX begin at the same plants.
    key = (plant, f.tobytes())
    if key not in data.numerators:
        found = accumulator.search(table, LINEAR_STEPS, LINEAR_TOLERANCE, UNDAMPED).table
        data.numerators[key] = found[b_rows(nu), : structure.b].copy()
    table[b_rows(nu), : structure.b] = data.numerators[key]
    if structure.c or structure.d:
        c, d = noise_start(accumulator.residual(table), structure.c, structure.d)
        table[ROW_C, : c.size], table[ROW_D, : d.size] = c, d
    return table


def noise_start(v: FloatArray, c_order: int, d_order: int) -> tuple[FloatArray, FloatArray]:
    """Return C and D of v = (C / D) e by Hannan and Rissanen's regressions on innovations of a long autoregression.

    Hannan and Rissanen 1982, doi:10.1093/biomet/69.1.81.
    """
    from ultraquiet.identify.prediction_error.kernels import normal_equations
    from ultraquiet.identify.prediction_error.kernels import table as table_kernels
    from ultraquiet.linalg.prediction import filtered

    before = max(c_order, d_order)
    memory = max(before, min(LONG_MEMORY, v.size // 8))
    e = _innovations(v, memory)
    c, d = np.ones(1), np.ones(1)
    columns = np.array([[0, 0, before, 1], [1, 1, d_order, 1], [2, 1, c_order, -1], [1, 0, 1, 1]])
    width = before + d_order + c_order + 1
    places = np.array([[0, 1, d_order], [1, 1, c_order]])
    for _ in range(HANNAN_ROUNDS):
        # v + sum_k d_k v(t-k) - sum_k c_k e(t-k) is to be small from sample `memory` on; a pulse takes out what is
        # there only to stand in the past of others.
        work = np.stack([np.zeros(v.size), v, e])[:, memory - before :]
        work = np.hstack([np.zeros((3, before + 1)), work])
        work[0, before + 1] = 1.0
        G = np.zeros((width, width))
        normal_equations.add_products(work, columns, 0, before + 1, work.shape[1], G)
        coefficients, _ = normal_equations.damped_step(normal_equations.reduced(G, before), 0.0)
        polynomials = np.zeros((2, max(c_order, d_order) + 1))
        polynomials[:, 0] = 1.0
        table_kernels.add_expanded(coefficients, 1.0, places, polynomials)
        d = stabilised(polynomials[0, : d_order + 1], NOISE_RADIUS)
        c = stabilised(polynomials[1, : c_order + 1], NOISE_RADIUS)
        e = filtered(v, d, c)
    return c, d


def _innovations(v: FloatArray, memory: int) -> FloatArray:
    """Return v less its best prediction from the last `memory` samples, zero before the record.

    Products of shifts differ along a diagonal by the samples that leave at the end alone.
    """
    from ultraquiet.linalg.prediction import filtered

    n = v.size
    whole = np.array([v[k:] @ v[: n - k] for k in range(memory + 1)])
    G = products_of_shifts(whole, v[n - memory :])
    G[np.diag_indices_from(G)] += LONG_RIDGE * G[0, 0]
    weights = np.linalg.solve(G[1:, 1:], G[1:, 0])
    return filtered(v, np.concatenate([[1.0], -weights]), np.ones(1))
