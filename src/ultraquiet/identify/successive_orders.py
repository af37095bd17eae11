"""Poles of a record at one order after the other, from one factorisation: what a stabilisation diagram shows."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet.identify.subspace import hankel
from ultraquiet.values import Record

LEAST_ROWS, SPARE = 6, 1.5  # block rows of past and of future; directions there are, over the highest order
SAMPLES_A_COLUMN = 3  # of a Hankel matrix, or noise looks like a mode


def poles_by_order(record: Record, most: int = 40) -> dict[int, ComplexArray]:
    """Return the poles in z of subspace models of order 2, 4, ... from one Hankel matrix of the record.

    Gamma_n = U_n S_n^(1/2) holds the first n directions of the extended observability matrix; A_n is the pseudoinverse
    of Gamma_n without its last block row times Gamma_n without its first. A mode of the plant stays where it is as n
    grows, one of noise wanders.

    Args:
        record: inputs `(nu, n)` and outputs `(ny, n)`; channels that do not move are left out.
        most: highest order; a short record ends before.

    Raises:
        InputError: no output moves, or the record is too short for any order.

    >>> from ultraquiet.values import StateSpace
    >>> plant = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    >>> u = np.random.default_rng(0).standard_normal((1, 2000))
    >>> np.sort_complex(poles_by_order(Record(u, plant.simulate(u), 100.0), 4)[2]).round(3).tolist()
    [(0.9-0.2j), (0.9+0.2j)]

    Reference: Van Overschee and De Moor 1996, chapter 4; Peeters and De Roeck 1999, doi:10.1006/mssp.1999.1249.
    """
    whole("poles_by_order", "most", most, 2)
    u, y = (_even(signals) for signals in (record.inputs, record.outputs))
    if not len(y):
        raise InputError("poles_by_order: no output of the record moves, so it has no poles.")
    rows = max(LEAST_ROWS, int(np.ceil(SPARE * most / len(y))))
    affordable = record.samples // (2 * SAMPLES_A_COLUMN * (len(u) + len(y)))
    rows = min(rows, affordable)
    if rows < 2 or (rows - 1) * len(y) < 2:
        raise InputError(
            f"poles_by_order: {record.samples} samples of {len(u) + len(y)} channels are too few for any order."
        )
    basis, values = hankel.observability(u, y, rows)
    highest = min(most, (rows - 1) * len(y), int(np.count_nonzero(values > 0)))
    orders = range(2, highest + 1, 2)
    return {n: np.linalg.eigvals(hankel.transition(basis, values, n, len(y))[0]).astype(np.complex128) for n in orders}


def frequency_and_damping(poles: ComplexArray, rate_hz: float) -> np.ndarray:
    """Return f in Hz and zeta `(m, 2)` of oscillating poles in z, conjugates counted once, the slowest first.

    s = rate ln z = 2 pi f (-zeta +- j sqrt(1 - zeta^2)).
    """
    upper = poles[poles.imag > 0]
    s = np.log(upper) * rate_hz
    size = np.abs(s)
    found = np.column_stack([size / (2 * np.pi), -s.real / np.where(size > 0, size, 1.0)])
    return found[np.argsort(found[:, 0], kind="stable")]


def _even(signals: np.ndarray) -> np.ndarray:
    """Return the channels that move, without their means, each of unit size."""
    centred = signals - signals.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean(centred**2, axis=1))
    moves = size > 0
    return centred[moves] / size[moves, None]
