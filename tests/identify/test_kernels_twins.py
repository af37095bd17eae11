"""The compiled kernels beside plain NumPy, written from the formulas."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from ultraquiet.identify.prediction_error import in_memory
from ultraquiet.identify.prediction_error.damping_policy import STUCK
from ultraquiet.identify.prediction_error.in_memory import InMemory
from ultraquiet.identify.prediction_error.kernels import filters, normal_equations
from ultraquiet.identify.prediction_error.kernels import table as table_kernels
from ultraquiet.identify.prediction_error.levenberg_marquardt import minimise
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.signals import signals_of
from ultraquiet.identify.prediction_error.structure import Structure, free_rows
from ultraquiet.identify.subspace import kernels as state_kernels
from ultraquiet.values import PolynomialModel

CASES = {
    "box-jenkins": Structure(0, 3, 2, 3, 2, 1),
    "armax": Structure(3, 2, 3, 0, 0, 2),
    "output-error": Structure(0, 3, 0, 0, 3, 0),
}
INPUTS, SAMPLES = 2, 600


def stable(rng, order):
    pairs = [np.array([1.0, *(-2 * r * np.cos(w), r * r)]) for r, w in rng.uniform(0.3, 0.9, (order // 2, 2))]
    out = np.array([1.0, -rng.uniform(0.2, 0.8)]) if order % 2 else np.ones(1)
    for p in pairs:
        out = np.convolve(out, p)
    return out


def table_of(structure, rng):
    table = Parameterisation.alike(structure, INPUTS).empty()
    orders = Parameterisation.alike(structure, INPUTS).degree()
    for row, order in enumerate(orders):
        if row >= 3 and (row - 3) % 2 == 0:
            table[row, :order] = rng.standard_normal(order)
        else:
            table[row, : order + 1] = stable(rng, order)
    return table


def plain_residual(u, y, table, structure, states, with_past=True):
    """e = (D/C)(A y - sum B/F u), past and constant taken out by least squares."""
    d, degree = structure, Parameterisation.alike(structure, INPUTS).degree()
    row = [table[k, : degree[k] + 1] for k in range(len(table))]

    def whiten(x):
        return lfilter(row[2], row[1], x)

    v = lfilter(row[0], [1.0], y)
    for j in range(INPUTS):
        b = np.concatenate([np.zeros(d.delay), table[3 + 2 * j, : d.b]])
        v = v - lfilter(b, row[4 + 2 * j], u[j])
    e = whiten(v)
    if not with_past:
        return e
    columns = []
    for j in range(INPUTS):
        h = whiten(lfilter([1.0], row[4 + 2 * j], np.eye(1, SAMPLES)[0]))
        columns += [np.concatenate([np.zeros(k), h[: SAMPLES - k]]) for k in range(states[4 + 2 * j])]
    h = lfilter([1.0], row[1], np.eye(1, SAMPLES)[0])
    columns += [np.concatenate([np.zeros(k), h[: SAMPLES - k]]) for k in range(states[1])]
    columns += [whiten(np.ones(SAMPLES))]
    X = np.stack(columns, axis=1)
    return e - X @ np.linalg.lstsq(X, e, rcond=None)[0]


@pytest.fixture(params=CASES, ids=str)
def case(request, rng):
    structure = CASES[request.param]
    u, y = rng.standard_normal((INPUTS, SAMPLES)), rng.standard_normal(SAMPLES)
    return structure, u, y, table_of(structure, rng), Parameterisation.alike(structure, INPUTS).states(True, True)


def signals(structure, states):
    free = free_rows(INPUTS, range(3 + 2 * INPUTS))
    return signals_of(Parameterisation.alike(structure, INPUTS), free, states)


def evaluate(structure, u, y, table, states):
    data = InMemory(u, y, signals(structure, states))
    return data.loss(table), data.residual(table), data.normal(table)


def test_residual_is_the_formula(case):
    structure, u, y, table, states = case
    loss, e, _ = evaluate(structure, u, y, table, states)
    plain = plain_residual(u, y, table, structure, states)
    print(f"\nresidual differs by {np.abs(e - plain).max() / np.abs(plain).max():.1e}")
    # Free responses of two polynomials can be nearly parallel; normal equations then keep half the digits of their sum.
    assert e == pytest.approx(plain, abs=1e-4 * np.abs(plain).max())
    assert loss == pytest.approx(np.mean(plain**2), rel=1e-7)


def test_gradient_is_the_slope_of_the_residual(case, rng):
    structure, u, y, table, states = case
    _, e, S = evaluate(structure, u, y, table, states)
    p = S.shape[0] - 1
    step, h = rng.standard_normal(p), 1e-6
    losses = []
    for sign in (1, -1):
        moved = table.copy()
        table_kernels.add_expanded(sign * h * step, 1.0, signals(structure, states).moves, moved)
        losses.append(np.sum(plain_residual(u, y, moved, structure, states) ** 2))
    slope = (losses[0] - losses[1]) / (2 * h)
    print(f"\nslope of e'e by filters {2 * S[:p, p] @ step:.8g}, by differences {slope:.8g}")
    assert 2 * S[:p, p] @ step == pytest.approx(slope, rel=1e-4, abs=1e-6 * np.sum(e**2))


@dataclass(frozen=True, eq=False)
class PlainPoint:
    """A point of `minimise` whose residual and gradient are formed one call at a time."""

    data: InMemory
    table: np.ndarray
    criterion: float

    @property
    def unit(self):
        return self.criterion

    def normal(self):
        return self.data.normal(self.table)

    def moved(self, step):
        table = in_memory.moved(self.data.signals, self.table, step)
        return None if table is None else PlainPoint(self.data, table, self.data.loss(table))

    def gained(self, other):
        return self.data.samples * (self.criterion - other.criterion)


@pytest.mark.parametrize("steps", [0, 1, 60])
@pytest.mark.parametrize("size", [1.0, 1e6])
@pytest.mark.parametrize("at_once", [0, in_memory.SAMPLES_AT_ONCE])
def test_a_search_is_the_plain_one(case, steps, size, at_once, rng, monkeypatch):
    """To the last bit, of an output that the model explains in part, also where a step no longer gains.

    In one call, and in calls of four steps that take up where the last one ended.
    """
    monkeypatch.setattr(in_memory, "SAMPLES_AT_ONCE", at_once)
    structure, u, y, table, states = case
    start, tolerance = table_of(structure, rng), 0.0 if size > 1 else 1e-3
    for j in range(INPUTS):
        b = np.concatenate([np.zeros(structure.delay), table[3 + 2 * j, : structure.b]])
        y = y + lfilter(b, np.convolve(table[0, : structure.a + 1], table[4 + 2 * j, : structure.f + 1]), 10 * u[j])
    y = size * y
    held, plain = (InMemory(u, y, signals(structure, states)) for _ in range(2))
    begun = start.copy()
    found = held.search(start, steps, tolerance)
    twin = minimise(PlainPoint(plain, start, plain.loss(start)), steps, tolerance)
    print(f"\nloss {plain.loss(start):.4g} -> {found.loss:.4g} in {found.iterations} steps, state {found.state}")
    assert (found.iterations, found.state, found.loss) == (twin.iterations, twin.state, twin.point.criterion)
    assert np.array_equal(found.table, twin.point.table)
    assert np.array_equal(found.normal, twin.normal)
    assert np.array_equal(held.residual(found.table), plain.residual(found.table))
    assert np.array_equal(start, begun)


def test_a_search_of_no_number_ends_where_it_began(case):
    structure, u, y, table, states = case
    found = InMemory(u, np.full_like(y, np.nan), signals(structure, states)).search(table, 60, 1e-3)
    assert (found.state, found.iterations) == (STUCK, 0)
    assert np.array_equal(found.table, table)


HEAD = 40


def behind_head(x):
    return np.hstack([np.zeros((*x.shape[:-1], HEAD)), x])


@pytest.mark.parametrize("order", [0, 1, 2, 5, 8, 9, 13])
def test_filters_are_the_plain_ones(order, rng):
    """Up to eight taps stand in registers, more are looped over; pieces of a record end anywhere."""
    x, p = rng.standard_normal(int(rng.integers(20, 1000))), stable(rng, order)
    z, out = behind_head(x), np.zeros(HEAD + x.size)
    cut = HEAD + int(rng.integers(1, x.size))
    for first, stop in ((HEAD, cut), (cut, z.size)):
        filters.all_pole(z, p, order, out, first, stop)
    plain = lfilter([1.0], p, x)
    assert out[HEAD:] == pytest.approx(plain, rel=1e-9, abs=1e-9 * np.abs(plain).max())
    for lag in (0, 1, 7, 25):
        for first, stop in ((HEAD, cut), (cut, z.size)):
            filters.moving(z, p, order + 1, lag, 0, out, first, stop)
        plain = lfilter(np.concatenate([np.zeros(lag), p]), [1.0], x)
        assert out[HEAD:] == pytest.approx(plain, rel=1e-9, abs=1e-12)
        filters.moving(z, -p, order + 1, lag, filters.ADDED, out, HEAD, z.size)
        assert np.abs(out).max() <= 1e-12 * np.abs(plain).max()


def test_steps_are_filters_one_after_the_other(rng):
    """Moving sum, what is added to it and the division, of rows and coefficients by their numbers."""
    z, c, d = behind_head(rng.standard_normal((4, 300))), stable(rng, 3), stable(rng, 2)
    coefficients = np.zeros((3, 4))
    coefficients[1, :4], coefficients[2, :3] = c, d
    both = filters.MOVING | filters.ALL_POLE
    steps = np.array([[both, 0, 2, 2, 3, 5, 1, 3], [filters.ADDED, 1, 2, 2, 1, 0, 0, 0]])
    filters.filtered(steps, coefficients, z, HEAD, z.shape[1])
    plain = lfilter(np.r_[np.zeros(5), d], c, z[0]) + d[0] * z[1]
    assert z[2] == pytest.approx(plain, rel=1e-9, abs=1e-9)


def test_decayed_responses_leave_no_denormal_tail(rng):
    """Numbers below the smallest normal one cost twenty times the work; those kept in registers end in zeros."""
    pulse = behind_head(np.eye(1, 20_000)[0])
    for order in (1, 5, 8, 9):
        out = np.zeros(pulse.size)
        filters.all_pole(pulse, stable(rng, order), order, out, HEAD, pulse.size)
        assert not np.any((out != 0.0) & (np.abs(out) < np.finfo(float).tiny))
        assert np.abs(out[-100:]).max() < (1e-300 if order <= filters.REGISTERS else 1e-130)


def test_delta_weights_expanded(rng):
    weights, x, taps = rng.standard_normal(5), rng.standard_normal(300), np.zeros((2, 7))
    table_kernels.add_expanded(weights, -2.0, np.array([[1, 2, 5]]), taps)
    plain, column = np.zeros(300), np.concatenate([np.zeros(2), x[:-2]])
    for w in weights:
        plain -= 2.0 * w * column
        column = column - np.concatenate([[0.0], column[:-1]])
    assert lfilter(taps[1], [1.0], x) == pytest.approx(plain, rel=1e-10, abs=1e-10)
    assert not taps[0].any()


def plain_columns(x, columns):
    rows = []
    for row, lag, count, sign in columns:
        column = sign * np.concatenate([np.zeros(lag), x[row, : x.shape[1] - lag]])
        for _ in range(count):
            rows.append(column)
            column = column - np.concatenate([[0.0], column[:-1]])
    return np.array(rows)


def test_products_of_shifted_differences(rng):
    """Over a record in one piece and in two, with the products of the first columns known and not."""
    x, columns = rng.standard_normal((3, 5000)), np.array([[0, 1, 4, 1], [1, 3, 0, 1], [2, 3, 3, -1], [1, 0, 2, 1]])
    rows = plain_columns(x, columns)
    wanted, z = rows @ rows.T, behind_head(x)
    for pieces in ((HEAD, z.shape[1]), (HEAD, HEAD + 1777, z.shape[1])):
        G = np.zeros((9, 9))
        for first, stop in pairwise(pieces):
            normal_equations.add_products(z, columns, 0, first, stop, G)
        assert pytest.approx(wanted, rel=1e-10, abs=1e-8) == G
    known = np.zeros((9, 9))
    known[:4, :4] = G[:4, :4]
    normal_equations.add_products(z, columns, 4, HEAD, z.shape[1], known)
    assert known == pytest.approx(wanted, rel=1e-10, abs=1e-8)


def test_roots_inside(rng):
    for _ in range(300):
        p = np.concatenate([[1.0], rng.standard_normal(rng.integers(1, 6)) * rng.uniform(0.1, 1.2)])
        radius = np.abs(np.roots(p)).max()
        if abs(radius - table_kernels.WITHIN) > 1e-7:
            assert table_kernels.inside(p, p.size - 1) == (radius < table_kernels.WITHIN)


def test_no_model_leaves_with_a_root_outside_however_crowded(rng):
    """Eight roots, most of them near z = 1, the largest a hair outside: the recursion cannot tell, the fit must."""
    from ultraquiet.identify.prediction_error.model_table import settled

    for _ in range(200):
        pairs = np.exp(rng.uniform(-0.2, -0.001, 3) + 1j * rng.uniform(0.005, 1.5, 3))
        p = np.poly([*pairs, *pairs.conj(), rng.uniform(0.9, 0.99), 1.0 + 10.0 ** rng.uniform(-11, -6)]).real
        q = settled(p)
        model = PolynomialModel([[0.0, 1.0]], [q], 3500.0)
        assert model.is_stable()
        assert model.state_space().is_stable()
        assert np.abs(q - p).max() < 1e-3 * np.abs(p).max()


def test_hankel_gram(rng):
    z, rows = rng.standard_normal((3, 400)), 7
    H = np.vstack([z[:, i : i + 400 - rows + 1] for i in range(rows)])
    assert state_kernels.hankel_gram(z, rows) == pytest.approx(H @ H.T, rel=1e-9, abs=1e-9)


def test_modal_gram(rng):
    poles = np.array([0.9 + 0.2j, 0.5 + 0.0j])
    u, tail = rng.standard_normal((2, 3000)), rng.standard_normal((1, 3000))
    rows = []
    for p in poles:
        for x in u:
            s = lfilter([1.0], [1.0, -p], x.astype(complex))
            rows += [s.real, s.imag]
    Z = np.vstack([*rows, tail])
    assert state_kernels.modal_gram(poles, u, tail) == pytest.approx(Z @ Z.T, rel=1e-9, abs=1e-8)
