"""A law in evenly scaled coordinates: the same law to the last bit of its response, states scaled by powers of two."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.law.biquad import parts_of
from ultraquiet.values.state_space import StateSpace

# Sweeps until no scale moves by more than half a power of two; Osborne's iteration takes about ten.
SWEEPS = 100
# The closing of outputs to inputs is set anew so often; after that B and C are as large as what couples the parts.
CLOSINGS = 12


def balanced(system: StateSpace, like: StateSpace | None = None) -> StateSpace:
    """Return a system with every state scaled by a power of two so that rows and columns are alike in size.

    x_old = T x, T = diag(2^e): A becomes T^-1 A T, B T^-1 B and C C T, exactly but where a number leaves the range of
    float64. First the states that act on each other both ways are balanced by A alone; then such groups, inputs and
    outputs against each other, every output closed to every input by one gain, so that neither the units of channels
    nor the gain of the whole decide; last B against C in every part that exchanges nothing with the others. What is not
    driven or not seen is left as it is.

    Args:
        system: in any coordinates.
        like: a system of as many states whose powers of two are taken, so that both stay in the same coordinates.

    >>> skewed = StateSpace([[0.5, 1e9], [1e-9, 0.5]], [[1e9], [0.0]], [[1e-6, 0.0]], [[0.0]], rate_hz=1.0)
    >>> even = balanced(skewed)
    >>> bool(np.abs(even.A).max() < 2.0), bool(0.01 < even.B[0, 0] / even.C[0, 0] < 100.0)
    (True, True)

    Osborne 1960, doi:10.1145/321043.321048; powers of two: Parlett and Reinsch 1969, doi:10.1007/BF02165404.
    """
    exponents = _exponents(system if like is None or like.states != system.states else like)
    return StateSpace(
        *_scaled(system, exponents),
        system.D,
        system.rate_hz,
        actuators=system.actuators,
        sensors=system.sensors,
        provenance=system.provenance,
    )


def _exponents(system: StateSpace) -> NDArray[np.int64]:
    """Return e `(n,)` of x_old = diag(2^e) x."""
    if not system.states:
        return np.zeros(0, dtype=np.int64)
    count, group = connected_components(system.A != 0, directed=True, connection="strong")
    exponents = np.zeros(system.states, dtype=np.int64)
    for k in range(count):
        own = np.flatnonzero(group == k)
        if own.size > 1:
            exponents[own] = np.rint(_even(_squares(system.A[np.ix_(own, own)]), np.zeros(own.size))).astype(np.int64)
    exponents += _between_groups(*_scaled(system, exponents), group)[group]
    _, B, C = _scaled(system, exponents)
    for part in parts_of(system.A):
        into, out = (_size(M) for M in (B[part], C[:, part]))
        if np.isfinite(into) and np.isfinite(out):
            exponents[part] += round((into - out) / 4)
    return exponents


def _scaled(system: StateSpace, e: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
    rows, columns = e[:, None], e[None, :]
    return np.ldexp(system.A, columns - rows), np.ldexp(system.B, -rows), np.ldexp(system.C, columns)


def _between_groups(A: FloatArray, B: FloatArray, C: FloatArray, group: NDArray[Any]) -> NDArray[np.int64]:
    """Return the power of two of each group of states, from groups, inputs and outputs balanced as one graph."""
    count, (n, nu), ny = int(group.max()) + 1, B.shape, C.shape[0]
    nodes = np.concatenate([group, count + np.arange(nu + ny)])
    sizes = np.zeros((n + nu + ny,) * 2)
    sizes[:n, :n], sizes[:n, n : n + nu], sizes[n + nu :, :n] = A, B, C
    graph = np.full((count + nu + ny,) * 2, -np.inf)
    np.logaddexp2.at(graph, (nodes[:, None], nodes[None, :]), _squares(sizes))
    inputs, outputs = slice(count, count + nu), slice(count + nu, None)
    graph[inputs, outputs] = 0.0
    x = np.zeros(len(graph))
    for _ in range(CLOSINGS):
        x = _even(graph, x)
        even = graph + 2 * (x[None, :] - x[:, None])
        ends = max(even[:count, inputs].max(initial=-np.inf), even[outputs, :count].max(initial=-np.inf))
        if not np.isfinite(ends):
            break
        graph[inputs, outputs] -= 3 * ends
    return np.rint(x[:count]).astype(np.int64)


def _squares(M: FloatArray) -> FloatArray:
    """Return log2 of the squares of a matrix's entries, which no size of theirs takes out of range."""
    with np.errstate(divide="ignore"):
        return 2 * np.log2(np.abs(M))


def _size(M: FloatArray) -> float:
    """Return log2 of the sum of the squares."""
    return float(np.logaddexp2.reduce(_squares(M).ravel(), initial=-np.inf))


def _even(graph: FloatArray, x: FloatArray) -> FloatArray:
    """Return log2 of the scales at which what comes into each node is as large as what leaves it.

    `graph` holds log2 of the squares; what a node does to itself does not count.
    """
    graph, x = graph.copy(), x.copy()
    np.fill_diagonal(graph, -np.inf)
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(len(graph)):
            into = np.logaddexp2.reduce(graph[i] + 2 * x)
            out = np.logaddexp2.reduce(graph[:, i] - 2 * x)
            if np.isfinite(into) and np.isfinite(out):
                new = (into - out) / 4
                moved, x[i] = max(moved, abs(new - x[i])), new
        if moved < 0.5:
            break
    return x
