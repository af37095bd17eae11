"""Families of generalised plants, drawn: what H-infinity synthesis meets outside textbooks.

Each family takes a generator and gives P, ny, nu; `problem(family, seed)` makes one of any.
"""

import numpy as np

from ultraquiet.design import four_block, output_shaping
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain, series

RATE = 1000.0


def oscillators(rng):
    """Lightly damped modes over two decades, disturbed at the input and measured with noise."""
    modes, ny, nu = int(rng.integers(1, 16)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    w, zeta = 10 ** rng.uniform(0, 2, modes), 10 ** rng.uniform(-4, -1, modes)
    A, B, C = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, nu)), np.zeros((ny, 2 * modes))
    for k in range(modes):
        pair = slice(2 * k, 2 * k + 2)
        A[pair, pair] = [[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]]
        B[2 * k + 1], C[:, 2 * k + 1] = rng.standard_normal(nu), rng.standard_normal(ny)
    G = StateSpace(A, B, C, np.zeros((ny, nu)))
    return _weighted(rng, G), ny, nu


def delays(rng):
    """Random modes behind one to ten samples of delay on each input."""
    ny, nu = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    n = int(rng.integers(1, 8))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.6, 1.02) / np.abs(np.linalg.eigvals(A)).max()
    G = StateSpace(A, rng.standard_normal((n, nu)), rng.standard_normal((ny, n)), np.zeros((ny, nu)), RATE)
    late = StateSpace(*discretize.delay(int(rng.integers(1, 11)), nu), rate_hz=RATE)
    return _weighted(rng, series(late, G)), ny, nu


def integrators(rng):
    """Chains of one to three integrators with a stable rest, disturbed at the input."""
    chain, n = int(rng.integers(1, 4)), int(rng.integers(0, 6))
    A = np.zeros((chain + n, chain + n))
    A[:chain, :chain] = np.eye(chain, k=1)
    A[chain:, chain:] = rng.standard_normal((n, n)) - 3 * np.eye(n)
    A[:chain, chain:] = rng.standard_normal((chain, n))
    B, C = rng.standard_normal((chain + n, 1)), rng.standard_normal((1, chain + n))
    C[0, 0] = 1.0
    return _weighted(rng, StateSpace(A, B, C, np.zeros((1, 1)))), 1, 1


def cancellations(rng):
    """Poles that zeros all but cancel, at a relative distance between 1e-2 and 1e-10."""
    n = int(rng.integers(1, 6))
    poles, far = -(10 ** rng.uniform(-1, 2, n)), 10 ** rng.uniform(-10, -2, n)
    A, B, C = np.diag(poles), np.ones((n, 1)), (far * np.abs(poles))[None, :]
    fast = StateSpace([[-1.0, 5.0], [-5.0, -0.2]], [[0.0], [5.0]], [[1.0, 0.0]], [[0.0]])
    pairs = StateSpace(A, B, C, [[1.0]])
    return _weighted(rng, series(pairs, fast)), 1, 1


def dense(rng):
    """Random matrices, a third of the poles unstable, all direct terms full."""
    n = int(rng.integers(2, 30))
    nu, ny = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    m, p = ny + int(rng.integers(0, 3)), nu + int(rng.integers(0, 3))
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 0.4 * np.eye(n)
    D = rng.standard_normal((p + ny, m + nu))
    D[p:, m:] = 0
    return StateSpace(A, rng.standard_normal((n, m + nu)), rng.standard_normal((p + ny, n)), D), ny, nu


def sampled(rng):
    """The same in discrete time."""
    P, ny, nu = dense(rng)
    A = rng.standard_normal((P.states, P.states))
    A *= rng.uniform(0.7, 1.1) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, P.B, P.C, P.D, RATE), ny, nu


def descriptors(rng):
    """E x' = A x + B u with an E of condition up to 1e4, made explicit."""
    P, ny, nu = dense(rng)
    n = P.states
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    E = U * np.geomspace(1, 10 ** rng.uniform(0, 4), n) @ V
    return StateSpace.from_descriptor(E, E @ P.A, E @ P.B, P.C, P.D), ny, nu


def singular(rng):
    """Direct terms D12 and D21 that lack rank, one or both, or are zero."""
    P, ny, nu = dense(rng)
    D = P.D.copy()
    p, m = D.shape[0] - ny, D.shape[1] - nu
    if rng.uniform() < 0.7:
        D[:p, m + int(rng.integers(nu)) :] = 0
    else:
        D[:p, m:] = 0
    if rng.uniform() < 0.5:
        D[p + int(rng.integers(ny)) :, :m] = 0
    return StateSpace(P.A, P.B, P.C, D), ny, nu


def units(rng):
    """One of the families above with states, controls and measurements in units up to 1e+-12."""
    P, ny, nu = REGULAR[int(rng.integers(len(REGULAR)))](rng)
    x, u, y = (10 ** rng.uniform(-12, 12, k) for k in (P.states, nu, ny))
    u, y = np.concatenate([np.ones(P.B.shape[1] - nu), u]), np.concatenate([np.ones(P.C.shape[0] - ny), y])
    return (
        StateSpace(P.A * x / x[:, None], P.B / x[:, None] * u, P.C * x * y[:, None], P.D * u * y[:, None], P.rate_hz),
        ny,
        nu,
    )


def large(rng):
    """Sixty to four hundred states: modes, or random matrices."""
    n = int(10 ** rng.uniform(np.log10(60), np.log10(400)))
    A = np.zeros((n, n))
    if rng.uniform() < 0.5:
        w, zeta = 10 ** rng.uniform(0, 2, n // 2), 10 ** rng.uniform(-3, -1, n // 2)
        for k in range(n // 2):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]]
        A[n - n % 2 :, n - n % 2 :] = -1.0
    else:
        A = rng.standard_normal((n, n)) / np.sqrt(n) - 0.9 * np.eye(n)
    B, C = rng.standard_normal((n, 3)), rng.standard_normal((3, n))
    G = StateSpace(A, B, C, np.zeros((3, 3)))
    return _weighted(rng, G), 3, 3


def _weighted(rng, G):
    """Return a four-block or S/KS problem with a first-order weight on the output."""
    ny, nu = G.D.shape
    corner = 10 ** rng.uniform(-1, 1)
    lag = (-corner * np.eye(ny), corner * np.eye(ny), np.eye(ny), 0.1 * np.eye(ny))
    if G.rate_hz is not None:
        lag = discretize.tustin(*lag, G.rate_hz)
    on_y, on_u = StateSpace(*lag, rate_hz=G.rate_hz), gain(10 ** rng.uniform(-2, 0) * np.eye(nu), G.rate_hz)
    if G.is_stable() and rng.uniform() < 0.4:
        return output_shaping(G, on_y, on_u)
    return four_block(G, on_y, on_u, np.eye(nu), 10 ** rng.uniform(-2, 0) * np.eye(ny))


REGULAR = (oscillators, delays, integrators, cancellations, dense, sampled, descriptors)
FAMILIES = {f.__name__: f for f in (*REGULAR, singular, units, large)}


def problem(family, seed):
    """Return P, ny and nu of a family."""
    return FAMILIES[family](np.random.default_rng([seed, *family.encode()]))
