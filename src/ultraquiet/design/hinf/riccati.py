"""The two-Riccati solution of the H-infinity problem in normalised coordinates: arrays in, arrays out.

Glover and Doyle 1988 (doi:10.1016/0167-6911(88)90055-2), in the form of Zhou, Doyle and Glover 1996, theorem 17.1.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, block_diag

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import balance
from ultraquiet.linalg.equations import continuous_riccati, newton_direction
from ultraquiet.linalg.even import even_states
from ultraquiet.linalg.ordered import Array, Matrices

EQUATIONS = {"X": "state-feedback", "Y": "filter"}
RANK = 1e-10  # a singular value of D12 or D21 below this share of the largest counts as zero
# What is left of C'C after a cancellation that should be complete, relative to C'C.
ROUND_OFF = 1e-12
ILL_POSED = 1e9  # 1 / singular value of I + Dk D22 beyond which more than half of the digits of the loop are gone
INDEFINITE = 1e-7  # X and Y may be this share of their largest eigenvalue below zero
# Below it, in units that make the diagonal one, the least eigenvalue of X or Y is looked at: it is negative where it is
# beyond this many times the error that one more Newton step shows.
FAINT = 1e-12
BEYOND = 10.0
# Below it no error of a semidefinite X is to blame: X has come through infinity, or so near that its sign is open.
GROSS = -0.1
SPREAD = 2.0  # the same for the spectral radius of XY, of which the step gives a second value


@dataclass(frozen=True)
class NormalisedPlant:
    """A generalised plant with D12 = [0; I], D21 = [0 I], D22 = 0, and what brings its controller back."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    into: Array  # y_normalised = into y
    out: Array  # u = out u_normalised
    D22: Array  # of the plant as it was given
    speed: float  # rad/s that were made one
    form: balance.Coordinates

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Sizes of w, u, z, y."""
        return self.B1.shape[1], self.B2.shape[1], self.C1.shape[0], self.C2.shape[0]


class Level(NamedTuple):
    """What one level gamma gave: the two solutions, rho(XY) / gamma^2, and why it fails (empty when it does not).

    X or Y are empty where they were not computed or do not exist; of the one that is indefinite, the matrix is kept.
    `proof` is whether the failure shows that no controller exists, and not only that an equation was not solved.
    """

    gamma: float
    X: Array
    Y: Array
    coupling: float = np.inf
    residuals: tuple[float, float] = (np.inf, np.inf)
    reason: str = ""
    proof: bool = False


def normalise(M: Matrices, ny: int, nu: int, in_parts: bool = False) -> NormalisedPlant:
    """Return the problem with frequencies near one, states in even modal coordinates, unit D12 and D21.

    `in_parts` as in `balance.modal`: where poles are repeated, two ways to put states together, of which one may give
    an equation that is solved and the other none.

    Raises:
        NumericalError: D12 lacks full column rank or D21 full row rank.
    """
    A, B, C, D = M
    p, m = D.shape[0] - ny, D.shape[1] - nu
    (z_side, u_side), (w_side, y_side) = _sides(D, ny, nu)
    # units are gone before the states are scaled by the sizes of their inputs and outputs
    inputs, outputs = block_diag(w_side, u_side), block_diag(z_side, y_side)
    B, C = B @ inputs, outputs.T @ C
    tempo = _h2_speed(A, B, C, ny, nu)
    A, B, C = A / tempo, B / np.sqrt(tempo), C / np.sqrt(tempo)
    form = balance.modal(*even_states(A, B, C)[:3], in_parts)
    return NormalisedPlant(
        A=form.A,
        B1=form.B[:, :m],
        B2=form.B[:, m:],
        C1=form.C[:p],
        C2=form.C[p:],
        D11=z_side.T @ D[:p, :m] @ w_side,
        into=y_side.T,
        out=u_side,
        D22=D[p:, m:],
        speed=tempo,
        form=form,
    )


def floor(plant: NormalisedPlant) -> float:
    """Return the level below which no controller helps, set by D11 alone."""
    m1, m2, p1, p2 = plant.sizes
    rows, columns = plant.D11[: p1 - m2], plant.D11[:, : m1 - p2]
    return max((float(np.linalg.norm(d, 2)) for d in (rows, columns) if d.size), default=0.0)


def attempt(plant: NormalisedPlant, gamma: float, filter_first: bool = False) -> Level:
    """Solve both equations at a level and say whether a controller exists there.

    The equation named by `filter_first` is solved first, so that a search which knows where levels fail fails soon.
    """
    none = np.zeros((0, 0))
    solutions, residuals, reason, proof = {"X": none, "Y": none}, {"X": np.inf, "Y": np.inf}, "", False
    for name in ("Y", "X") if filter_first else ("X", "Y"):
        A, G, Q = equation(plant, gamma, name)
        try:
            solution = continuous_riccati(A, G, Q)
        except (NumericalError, LinAlgError) as error:
            reason = f"{EQUATIONS[name]} equation {name}: {error}"
            break
        solutions[name], residuals[name] = solution.X, solution.residual
        least, proof = _negative(A, G, Q, solution.X)
        if least < 0:
            how = "" if proof else " within its error"
            reason = f"{EQUATIONS[name]} equation: {name} is indefinite{how}, smallest eigenvalue {least:.2e}"
            break
    X, Y = solutions["X"], solutions["Y"]
    coupling = np.inf
    if not reason:
        coupling = float(np.abs(np.linalg.eigvals(X @ Y)).max()) / gamma**2 if X.size else 0.0
        reason = "" if coupling < 1 else f"the spectral radius of XY is {coupling:.6g} gamma^2"
    return Level(gamma, X, Y, coupling, (residuals["X"], residuals["Y"]), reason, proof)


def is_proof(plant: NormalisedPlant, level: Level) -> bool:
    """Return whether a level that fails is shown to be out of reach: for a coupling, beyond the errors of X and Y."""
    if level.proof or not 1 <= level.coupling < np.inf:
        return level.proof
    better = [X + _error(*equation(plant, level.gamma, n), X) for n, X in (("X", level.X), ("Y", level.Y))]
    if not all(np.isfinite(X).all() for X in better):
        return False
    coupling = float(np.abs(np.linalg.eigvals(better[0] @ better[1])).max()) / level.gamma**2
    return min(coupling, level.coupling) - SPREAD * abs(coupling - level.coupling) > 1


def _negative(A: Array, G: Array, Q: Array, X: Array) -> tuple[float, bool]:
    """Return the least eigenvalue of X at unit diagonal, zero where it is not negative, and whether it surely is."""
    if not X.size:
        return 0.0, False
    tiny = np.finfo(float).tiny
    natural = ROUND_OFF * float(np.linalg.norm(A)) / max(float(np.linalg.norm(G)), tiny)  # size of X where Q is zero
    unit = _unit_diagonal(X, natural)
    least = float(np.linalg.eigvalsh(X / unit)[0])
    if least > -FAINT:
        return 0.0, False
    certain = -least > BEYOND * float(np.linalg.norm(_error(A, G, Q, X) / unit))
    return (least, certain) if certain or least < GROSS else (0.0, False)


def _error(A: Array, G: Array, Q: Array, X: Array) -> Array:
    try:
        return newton_direction(A, G, Q, X)
    except NumericalError:
        return np.full(X.shape, np.inf)


def _unit_diagonal(X: Array, least: float = 0.0) -> Array:
    d = np.sqrt(np.maximum(np.abs(np.diag(X)), max(least, np.finfo(float).tiny)))
    return np.outer(d, d)


def central(plant: NormalisedPlant, level: Level) -> Matrices:
    """Return the central controller of a level, u = K y, in the plant's own inputs and outputs."""
    m1, m2, p1, p2 = plant.sizes
    g2 = level.gamma**2
    B, D11 = np.hstack([plant.B1, plant.B2]), plant.D11
    F, L = _side(plant, "X").gain(level.gamma, level.X), _side(plant, "Y").gain(level.gamma, level.Y).T
    a, b = p1 - m2, m1 - p2
    D1111, D1112, D1121, D1122 = D11[:a, :b], D11[:a, b:], D11[a:, :b], D11[a:, b:]
    left = np.linalg.solve(g2 * np.eye(a) - D1111 @ D1111.T, D1112)
    Dk = -D1121 @ D1111.T @ left - D1122
    # hat D12 and hat D21 are Cholesky factors
    D12 = np.linalg.cholesky(np.eye(m2) - D1121 @ np.linalg.solve(g2 * np.eye(b) - D1111.T @ D1111, D1121.T))
    D21 = np.linalg.cholesky(np.eye(p2) - D1112.T @ left).T
    n = plant.A.shape[0]
    Z = np.linalg.solve(np.eye(n) - level.Y @ level.X / g2, np.hstack([plant.B2 + L[:, a:p1], L[:, p1:]]))
    B2k, ZL2 = Z[:, :m2] @ D12, Z[:, m2:]
    C2k = -D21 @ (plant.C2 + F[b:m1])
    Bk = -ZL2 + B2k @ np.linalg.solve(D12, Dk)
    inner = np.linalg.solve(D21, C2k)
    Ck = F[m1:] + Dk @ inner
    Ak = plant.A + B @ F + Bk @ inner
    return _restored(plant, Ak, Bk, Ck, Dk)


def normalised_controller(plant: NormalisedPlant, M: Matrices) -> Matrices:
    """Return the controller as it meets the normalised plant: the way back of `central`'s last step."""
    A, B, C, D = M
    wrap = np.eye(D.shape[0]) - D @ plant.D22
    CD = np.linalg.solve(wrap, np.hstack([C, D]))
    n = A.shape[0]
    A, B, C, D = A + B @ plant.D22 @ CD[:, :n], B + B @ plant.D22 @ CD[:, n:], CD[:, :n], CD[:, n:]
    root, out = np.sqrt(plant.speed), np.linalg.inv(plant.out)
    back = np.linalg.inv(plant.into)
    return A / plant.speed, B @ back / root, out @ C / root, out @ D @ back


def direct_terms(plant: NormalisedPlant) -> tuple[Array, Array]:
    """Return D12 = [0; I] and D21 = [0 I]."""
    m1, m2, p1, p2 = plant.sizes
    return np.eye(p1, m2, k=-(p1 - m2)), np.eye(p2, m1, k=m1 - p2)


def _restored(plant: NormalisedPlant, A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """Undo the scaling of inputs, outputs and frequency and the removal of D22."""
    root = np.sqrt(plant.speed)
    A, B, C, D = A * plant.speed, B @ plant.into * root, plant.out @ C * root, plant.out @ D @ plant.into
    return with_direct_term((A, B, C, D), plant.D22)


def with_direct_term(M: Matrices, D22: Array) -> Matrices:
    """Return K that does to y = y0 + D22 u what a controller K0 does to y0: u = K0 (y - D22 u).

    Raises:
        NumericalError: the loop is ill-posed.
    """
    A, B, C, D = M
    wrap = np.eye(D.shape[0]) + D @ D22
    if np.linalg.norm(wrap, -2) * ILL_POSED < 1 + np.linalg.norm(D, 2) * np.linalg.norm(D22, 2):
        raise NumericalError("H-infinity synthesis: the direct term D22 makes the loop ill-posed; delay it a sample.")
    CD = np.linalg.solve(wrap, np.hstack([C, D]))
    n = A.shape[0]
    state = np.hstack([A, B]) - B @ D22 @ CD
    return state[:, :n], state[:, n:], CD[:, :n], CD[:, n:]


class _Side(NamedTuple):
    """One equation's data with u = v - Cb x - Db w, which leaves the cost |Ca x + Da w|^2 + |v|^2 - gamma^2 |w|^2.

    Written so, nothing cancels: R = [Da'Da - gamma^2, 0; 0, I] instead of a matrix whose inverse loses gamma^2 beside
    D11'D11, and Q is zero where every cost can be met.
    """

    A: Array
    B1: Array
    B2: Array
    Ca: Array
    Cb: Array
    Da: Array
    Db: Array

    def inner(self, gamma: float) -> Array:
        """Return gamma^2 - Da'Da."""
        return gamma**2 * np.eye(self.Da.shape[1]) - self.Da.T @ self.Da

    def gain(self, gamma: float, X: Array) -> Array:
        """Return F with (w; u) = F x, the worst disturbance and the best control."""
        w = np.linalg.solve(self.inner(gamma), self.Da.T @ self.Ca + self.B1.T @ X)
        return np.vstack([w, -self.B2.T @ X - self.Cb - self.Db @ w])


def _side(plant: NormalisedPlant, name: str) -> _Side:
    """Return the data of X, or those of Y: the same with everything transposed."""
    A, B1, B2, C1, D11 = plant.A, plant.B1, plant.B2, plant.C1, plant.D11
    if name == "Y":
        A, B1, B2, C1, D11 = A.T, C1.T, plant.C2.T, B1.T, D11.T
    rows = C1.shape[0] - B2.shape[1]
    Ca, Cb, Da, Db = C1[:rows], C1[rows:], D11[:rows], D11[rows:]
    return _Side(A - B2 @ Cb, B1 - B2 @ Db, B2, Ca, Cb, Da, Db)


def equation(plant: NormalisedPlant, gamma: float, name: str) -> tuple[Array, Array, Array]:
    """Return A, G, Q of the equation A'X + X A - X G X + Q = 0 for X, or of its dual for Y."""
    side = _side(plant, name)
    cross, n = side.Da.T @ side.Ca, side.A.shape[0]
    solved = np.linalg.solve(side.inner(gamma), np.hstack([cross, side.B1.T]))
    G, Q = side.B2 @ side.B2.T - side.B1 @ solved[:, n:], side.Ca.T @ side.Ca + cross.T @ solved[:, :n]
    if np.linalg.norm(Q) <= ROUND_OFF * (np.sum(side.Cb**2) + np.linalg.norm(Q)):
        Q = np.zeros_like(Q)  # the whole cost can be met: the X or Y of a mixed-sensitivity problem is zero
    return side.A + side.B1 @ solved[:, :n], (G + G.T) / 2, (Q + Q.T) / 2


def _sides(D: Array, ny: int, nu: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return what makes D12 and what makes D21' [0; I], as `_unit` does."""
    p, m = D.shape[0] - ny, D.shape[1] - nu
    D12, D21 = D[:p, m:], D[p:, :m]
    return (
        _unit(D12, "D12 (controls to performance outputs)", "columns"),
        _unit(D21.T, "D21 (disturbances to measurements)", "rows"),
    )


def _unit(D: Array, block: str, what: str) -> tuple[Array, Array]:
    """Return orthogonal U and a scaling V such that U' D V = [0; I].

    Raises:
        NumericalError: D lacks full column rank.
    """
    p, m = D.shape
    size = np.linalg.norm(D, axis=0)
    size = np.where(size > 0, size, 1.0)
    U, s, Vt = np.linalg.svd(D / size)
    if p < m or (m and s[-1] <= RANK * max(s[0], 1e-300)):
        rank = int(np.sum(s > RANK * max(float(s[0]), 1e-300))) if s.size and s[0] > 0 else 0
        raise NumericalError(
            f"H-infinity synthesis: {block} has rank {rank} where {m} is needed; every one of its {m} {what} must "
            "be weighted, add a small weight to those that are not or ask for regularise=True."
        )
    return np.hstack([U[:, m:], U[:, :m]]), Vt.T / s / size[:, None]


def speed(M: Matrices, ny: int, nu: int) -> float:
    """Return how fast a problem is, in rad/s or its own unit of time: the geometric mean of its H2 loop's poles.

    Where D12 or D21 has too little rank for there to be one, that of the plant's poles.
    """
    A, B, C, D = M
    try:
        (z_side, u_side), (w_side, y_side) = _sides(D, ny, nu)
    except NumericalError:
        return _mean_modulus(np.linalg.eigvals(A)) if A.size else 1.0
    return _h2_speed(A, B @ block_diag(w_side, u_side), block_diag(z_side, y_side).T @ C, ny, nu)


def _h2_speed(A: Array, B: Array, C: Array, ny: int, nu: int) -> float:
    """Return the geometric mean of the moduli of the poles of the H2 loop, with unit D12 and D21.

    They are those of the equations of X and Y at an infinite level. The poles of the plant do not tell how fast its
    loop is: that of a lag which is slow beside its gain is as nothing to it. Units of states change none of them.
    """
    if not A.size:
        return 1.0
    p, m = C.shape[0] - ny, B.shape[1] - nu
    loops = [_hamiltonian(A, B[:, m:], C[:p]), _hamiltonian(A.T, C[p:].T, B[:, :m].T)]
    return _mean_modulus(np.concatenate([np.linalg.eigvals(H) for H in loops]))


def _hamiltonian(A: Array, B2: Array, C1: Array) -> Array:
    rows = C1.shape[0] - B2.shape[1]
    without = A - B2 @ C1[rows:]
    return np.block([[without, -B2 @ B2.T], [-C1[:rows].T @ C1[:rows], -without.T]])


def _mean_modulus(poles: Array) -> float:
    """Return the geometric mean of the moduli, those near zero left out."""
    size = np.abs(poles)
    size = size[size > 1e-9 * max(float(size.max()), 1e-300)]
    return float(np.exp(np.mean(np.log(size)))) if size.size else 1.0
