"""Systems joined to larger systems."""

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.values.joined.algebra import is_singular
from ultraquiet.values.joined.wires import unswapped
from ultraquiet.values.state_space import StateSpace


def gain(D: ArrayLike, rate_hz: float | None = None) -> StateSpace:
    """Return a system without states, y = D u."""
    d = np.atleast_2d(np.asarray(D, dtype=np.float64))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0)), d, rate_hz)


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return second * first: the output of `first` drives `second`.

    >>> complex(series(gain([[2.0]]), gain([[3.0]])).frequency_response([0.0])[0, 0, 0])
    (6+0j)
    """
    same_rate("series", "the first system", first.rate_hz, "the second", second.rate_hz)
    if first.D.shape[0] != second.D.shape[1]:
        raise InputError(f"series: {first.D.shape[0]} outputs cannot drive {second.D.shape[1]} inputs.")
    A = np.block(
        [[first.A, np.zeros((first.states, second.states))], [second.B @ first.C, second.A]],
    )
    B = np.vstack([first.B, second.B @ first.D])
    C = np.hstack([second.D @ first.C, second.C])
    return StateSpace(A, B, C, second.D @ first.D, first.rate_hz)


def parallel(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return first + second: one input to both, outputs added."""
    same_rate("parallel", "the first system", first.rate_hz, "the second", second.rate_hz)
    if first.D.shape != second.D.shape:
        raise InputError(f"parallel: shapes {first.D.shape} and {second.D.shape} differ.")
    A = _diagonal([first.A, second.A])
    return StateSpace(
        A,
        np.vstack([first.B, second.B]),
        np.hstack([first.C, second.C]),
        first.D + second.D,
        first.rate_hz,
    )


def append(*systems: StateSpace) -> StateSpace:
    """Return the systems side by side, diag(G1, G2, ...): each keeps its own inputs and outputs."""
    if not systems:
        raise InputError("append: give at least one system.")
    for other in systems[1:]:
        same_rate("append", "the first system", systems[0].rate_hz, "another", other.rate_hz)
    A, B, C, D = (_diagonal([getattr(s, k) for s in systems]) for k in "ABCD")
    return StateSpace(A, B, C, D, systems[0].rate_hz)


def repeated(one: StateSpace, copies: int) -> StateSpace:
    """Return diag(one, ..., one), which does not couple its channels."""
    return one if copies == 1 else append(*[one] * copies)


def of_one_channel(system: StateSpace) -> tuple[StateSpace, int]:
    """Return k and the number of copies where a system is diag(k, ..., k), state by state, else the system and one.

    Equal to the last digit, as designs make it: a system that is so but for round-off is one of many channels.
    """
    n = system.D.shape[0]
    if system.D.shape != (n, n) or n < 2 or system.states % n:
        return system, 1
    m = system.states // n
    first = StateSpace(system.A[:m, :m], system.B[:m, :1], system.C[:1, :m], system.D[:1, :1], system.rate_hz)
    copies = repeated(first, n)
    same = all(np.array_equal(getattr(system, key), getattr(copies, key)) for key in "ABCD")
    return (first, n) if same else (system, 1)


def feedback(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return (I - G K)^-1 G, from a disturbance at the plant's input to its output, with u = K y and no minus sign.

    >>> complex(feedback(gain([[1.0]]), gain([[-3.0]])).frequency_response([0.0])[0, 0, 0])
    (0.25+0j)
    """
    unswapped("feedback", controller, plant)
    ny, nu = plant.D.shape
    D = np.block([[plant.D, plant.D], [plant.D, plant.D]])
    P = StateSpace(plant.A, np.hstack([plant.B, plant.B]), np.vstack([plant.C, plant.C]), D, plant.rate_hz)
    return lft(P, controller, measurements=ny, controls=nu)


def sensitivity(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return S = (I - G K)^-1, from a disturbance at the plant's output to its output, with u = K y."""
    unswapped("sensitivity", controller, plant)
    ny, nu = plant.D.shape
    one = np.eye(ny)
    P = StateSpace(
        plant.A,
        np.hstack([np.zeros((plant.states, ny)), plant.B]),
        np.vstack([plant.C, plant.C]),
        np.block([[one, plant.D], [one, plant.D]]),
        plant.rate_hz,
    )
    return lft(P, controller, measurements=ny, controls=nu)


def lft(P: StateSpace, K: StateSpace, measurements: int | None = None, controls: int | None = None) -> StateSpace:
    """Return F(P, K) = P11 + P12 K (I - P22 K)^-1 P21: the last outputs of P drive K, which drives P's last inputs.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y).
        K: controller u = K y.
        measurements: size of y; that of K when absent.
        controls: size of u; that of K when absent.

    Raises:
        InputError: K does not fit, the rates differ, or the loop is not well posed (I - D22 Dk singular).
    """
    same_rate("lft", "the plant", P.rate_hz, "the controller", K.rate_hz)
    nu, ny = K.D.shape
    if (measurements or ny, controls or nu) != (ny, nu) or ny > P.D.shape[0] or nu > P.D.shape[1]:
        raise InputError(
            f"lft: the controller is {nu} x {ny} (outputs x inputs), the plant offers "
            f"{measurements or P.D.shape[0]} measurements and {controls or P.D.shape[1]} controls."
        )
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    B1, B2, C1, C2 = P.B[:, :m], P.B[:, m:], P.C[:p], P.C[p:]
    D11, D12, D21, D22 = P.D[:p, :m], P.D[:p, m:], P.D[p:, :m], P.D[p:, m:]
    loop = np.eye(ny) - D22 @ K.D
    if is_singular(loop, D22, K.D):
        raise InputError("lft: the loop is not well posed, I - D22 Dk is singular; put a delay into it.")
    # y = loop^-1 (C2 x + D22 Ck xk + D21 w)
    y = np.linalg.solve(loop, np.hstack([C2, D22 @ K.C, D21]))
    n, nk = P.states, K.states
    u = K.D @ y + np.hstack([np.zeros((nu, n)), K.C, np.zeros((nu, m))])
    top = np.hstack([P.A, np.zeros((n, nk)), B1]) + B2 @ u
    low = np.hstack([np.zeros((nk, n)), K.A, np.zeros((nk, m))]) + K.B @ y
    out = np.hstack([C1, np.zeros((p, nk)), D11]) + D12 @ u
    state = np.vstack([top, low])
    return StateSpace(state[:, : n + nk], state[:, n + nk :], out[:, : n + nk], out[:, n + nk :], P.rate_hz)


def _diagonal(parts: list[FloatArray]) -> FloatArray:
    """Place matrices along the diagonal; unlike SciPy's, blocks without rows or columns keep their place."""
    rows, columns = (np.cumsum([0] + [p.shape[k] for p in parts]) for k in (0, 1))
    out = np.zeros((rows[-1], columns[-1]))
    for k, part in enumerate(parts):
        out[rows[k] : rows[k + 1], columns[k] : columns[k + 1]] = part
    return out
