"""From poles and directions of a subspace to a whole model: least squares, refinement, noise."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.result import NO_NOISE
from ultraquiet.identify.subspace import gauss_newton, modal_least_squares
from ultraquiet.identify.subspace.gauss_newton import INTEGRATING, ROUNDED, STABLE_RADIUS
from ultraquiet.linalg import response
from ultraquiet.linalg.polynomial_roots import mirrored_inside
from ultraquiet.values import Record

UNTOLD = 1.0  # decay of a real pole over the whole record, in its logarithm, below which it may be an integrator's
PARALLEL = 1e9  # condition of eigenvectors beyond which modal coordinates hold no digits
# Twice the log likelihood that a pole kept inside the circle may cost before the search counts as ended away from its
# minimum: chi square of one number, exceeded by chance in one of a thousand records of an integrator.
AT_THE_EDGE = 10.83
GAIN_ROUNDS = 6  # of regression on the innovations of the round before


@dataclass(frozen=True, eq=False)
class Scaled:
    """A record's signals, each of unit deviation; outputs without their means.

    Inputs keep theirs: what the mean does is all a record says of modes far below its band. On the steel frame of DaISy
    96-013 (means of 0.3 and 0.4 deviations) the held-out fit of the worst output is 90 % with them, negative without.
    Beyond one deviation they lose the excess, see `excess`.
    """

    u: FloatArray
    y: FloatArray
    u_size: FloatArray
    y_size: FloatArray

    @classmethod
    def of(cls, record: Record) -> "Scaled":
        """Scale a record."""
        u_size = record.inputs.std(axis=1, keepdims=True)
        u = record.inputs - excess(record.inputs.mean(axis=1, keepdims=True), u_size)
        y = record.outputs - record.outputs.mean(axis=1, keepdims=True)
        y_size = y.std(axis=1, keepdims=True)
        return cls(u / u_size, y / y_size, u_size, y_size)

    @property
    def centred_u(self) -> FloatArray:
        """Inputs without their means."""
        return self.u - self.u.mean(axis=1, keepdims=True)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.u.shape[1]


def excess(mean: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return by how much means exceed their signals' deviations.

    A level of the inputs does no more than other initial states and another constant at the outputs do, and these are
    fitted; but products of hundreds of deviations leave of the rest no digits.

    >>> excess(np.array([0.4, -0.4, 1000.0, -1000.0]), np.ones(4)).tolist()
    [0.0, 0.0, 999.0, -999.0]
    """
    return mean - np.clip(mean, -deviation, deviation)


@dataclass(frozen=True, eq=False)
class System:
    """x+ = A x + B u + K e, y = C x + D u + constant + e from x0, in scaled units."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    K: FloatArray
    x0: FloatArray
    constant: FloatArray

    def simulated(self, u: FloatArray) -> FloatArray:
        """Return the outputs to inputs alone."""
        return response.simulate(self.A, self.B, self.C, self.D, u, self.x0) + self.constant[:, None]

    def errors(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step prediction errors."""
        none = np.zeros((len(self.C), len(self.C)))
        inner = self.A - self.K @ self.C
        v = y - self.constant[:, None]
        B = np.hstack([self.B - self.K @ self.D, self.K])
        return v - response.simulate(inner, B, self.C, np.hstack([self.D, none]), np.vstack([u, v]), self.x0)

    def predicted_from_inputs(self, u: FloatArray) -> FloatArray:
        """Return what the inputs alone, from rest, are to the one-step prediction: bounded if the plant is not, too."""
        inner = self.A - self.K @ self.C
        return response.simulate(inner, self.B - self.K @ self.D, self.C, self.D, u, np.zeros(len(inner)))

    def stable(self) -> bool:
        """Return whether every pole is inside the radius that finished models keep."""
        return bool(np.all(np.abs(np.linalg.eigvals(self.A)) <= INTEGRATING + ROUNDED))

    def predicts(self) -> bool:
        """Return whether the predictor forgets its past."""
        return bool(np.all(np.abs(np.linalg.eigvals(self.A - self.K @ self.C)) < 1.0))


@dataclass(frozen=True)
class Options:
    """What a search may move, and how it weighs: see `Subspace`."""

    feedthrough: bool
    offset: bool
    weighted: bool
    steps: int

    def direct(self, start: System) -> FloatArray:
        """Return the columns of a system that enter its outputs at once."""
        parts = ([start.D] if self.feedthrough else []) + ([start.constant[:, None]] if self.offset else [])
        return np.hstack(parts) if parts else np.zeros((len(start.C), 0))

    def parts(self, direct: FloatArray, nu: int) -> tuple[FloatArray, FloatArray]:
        """Return D and constant from those columns."""
        ny = len(direct)
        D = direct[:, :nu] if self.feedthrough else np.zeros((ny, nu))
        return D, direct[:, -1] if self.offset else np.zeros(ny)


class SystemFit(NamedTuple):
    """A system, the steps of the search for it, and whether that came to its end."""

    system: System
    steps: int
    converged: bool


def poles_inside(values: ComplexArray) -> ComplexArray:
    """Return poles mirrored into the circle, none nearer to it than 1 - STABLE_RADIUS but for one that integrates.

    >>> poles_inside(np.array([1.0, 0.5 + 0j])).tolist(), poles_inside(np.array([1.0, 1.0 + 0j])).tolist()
    ([(0.99999999+0j), (0.5+0j)], [(0.99999+0j), (0.99999+0j)])
    """
    inside = mirrored_inside(values, INTEGRATING)
    slow = (np.abs(inside.imag) <= modal_least_squares.IMAGINARY) & (inside.real > STABLE_RADIUS)
    kept = slow if np.count_nonzero(slow) == 1 else np.zeros_like(slow)
    return np.where(kept, inside, mirrored_inside(inside, STABLE_RADIUS))


def modes_of(A: FloatArray, C: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the poles of the upper half plane, drawn inside the circle, output directions `(ny, m)` of unit size.

    The third holds the states `(n, m)` of these directions.
    """
    values, vectors = np.linalg.eig(A)
    values = poles_inside(values.astype(np.complex128))
    real = np.abs(values.imag) <= modal_least_squares.IMAGINARY
    kept = np.concatenate([np.flatnonzero(~real & (values.imag > 0)), np.flatnonzero(real)])
    count = int(np.count_nonzero(~real & (values.imag > 0)))
    states = vectors[:, kept].astype(np.complex128)
    poles = values[kept].copy()
    poles[count:] = poles[count:].real
    states[:, count:] = states[:, count:].real
    directions = C @ states
    size = np.linalg.norm(directions, axis=0)
    return poles, directions / size, states / size


def system(modes: modal_least_squares.Modes) -> System:
    """Return real matrices of modes, without noise."""
    ny, nu = modes.D.shape
    joined = replace(modes, b=np.hstack([modes.b, modes.b[:, -1:]]), D=np.hstack([modes.D, np.zeros((ny, 1))]))
    real = joined.state_space(1.0)
    K = np.zeros((len(real.A), ny))
    return System(real.A, real.B[:, :nu], real.C, modes.D, K, real.B[:, nu], modes.constant)


def refined_simulation(start: System, data: Scaled, options: Options) -> SystemFit:
    """Return the system of least simulated error.

    Where noise draws the slowest pole beyond the circle no minimum lies inside: the search is then one with an
    integrator, whose pole is held.
    """
    signals = gauss_newton.Signals.of(data.u, data.u, data.y, options.feedthrough, options.offset)

    def searched(start: System) -> tuple[SystemFit, float]:
        drive = np.hstack([start.B, start.x0[:, None]])
        at = gauss_newton.BlockModel.of(start.A, drive, start.C, options.direct(start))
        outcome = gauss_newton.search(at, signals, options.weighted, options.steps, gauss_newton.BlockModel.inside)
        A, B, C = outcome.point.matrices()
        D, constant = options.parts(outcome.point.direct, len(data.u))
        found = System(A, B[:, :-1], C, D, np.zeros((len(A), len(C))), B[:, -1], constant)
        return SystemFit(found, outcome.steps, outcome.converged), outcome.loss

    free, loss = searched(start)
    integrating = with_an_integrator(free.system, data.samples)
    if integrating is None:
        return free
    held, lower = searched(integrating)
    return (held if lower < loss else free)._replace(steps=free.steps + held.steps)


def with_an_integrator(system: System, samples: int) -> System | None:
    """Return the system, its one real pole that a record of so many samples may not tell from 1 put there.

    None where there is no such pole, or more: two integrators in a row have no modal form.
    """
    values, vectors = (x.astype(np.complex128) for x in np.linalg.eig(system.A))
    slow = np.flatnonzero((values.imag == 0) & (samples * (1.0 - values.real) < UNTOLD))
    if slow.size != 1 or values[slow[0]].real >= INTEGRATING - ROUNDED:
        return None
    values[slow[0]] = INTEGRATING
    return replace(system, A=(vectors @ np.diag(values) @ np.linalg.inv(vectors)).real)


def refined_prediction(start: System, data: Scaled, options: Options, stable: bool = True) -> SystemFit:
    """Return the system of least one-step error.

    A start whose predictor has no modal form (parallel eigenvectors) is returned as it is, not converged. Where noise
    draws the pole of an integrator beyond the circle, a second search keeps inside; the better of it and of the first's
    end with that pole mirrored is returned: mirrored alone it may be worse than its start.
    """
    nu, ny = len(data.u), len(data.y)
    inner = start.A - start.K @ start.C
    if np.linalg.cond(np.linalg.eig(inner)[1]) > PARALLEL or not start.predicts():
        return SystemFit(start, 0, False)
    # The search takes the outputs as they are, with the constant c: its states lie (I - A + K C)^-1 K c above those of
    # outputs without it, and what it finds at the outputs is c less what these make of it.
    settled = np.linalg.solve(np.eye(len(inner)) - inner, start.K)
    shifted = replace(start, constant=start.constant - start.C @ settled @ start.constant)
    drive = np.hstack([start.B - start.K @ start.D, start.K, (start.x0 + settled @ start.constant)[:, None]])
    at = gauss_newton.BlockModel.of(inner, drive, start.C, options.direct(shifted))
    signals = gauss_newton.Signals.of(np.vstack([data.u, data.y]), data.u, data.y, options.feedthrough, options.offset)

    def system_at(at: gauss_newton.BlockModel) -> System:
        A, B, C = at.matrices()
        K = B[:, nu : nu + ny]
        D, total = options.parts(at.direct, nu)
        settled = np.linalg.solve(np.eye(len(A)) - A, K)
        constant = np.linalg.solve(np.eye(ny) - C @ settled, total).astype(np.float64)
        return System(A + K @ C, B[:, :nu] + K @ D, C, D, K, B[:, -1] - settled @ constant, constant)

    def searched(farthest: float) -> SystemFit:
        def admissible(at: gauss_newton.BlockModel) -> bool:
            return at.inside() and (not stable or np.abs(np.linalg.eigvals(system_at(at).A)).max() <= farthest)

        outcome = gauss_newton.search(at, signals, options.weighted, options.steps, admissible)
        return SystemFit(system_at(outcome.point), outcome.steps, outcome.converged)

    found = searched(1.0 + UNTOLD / data.samples)  # an integrator's pole that noise has drawn over the circle
    if not stable:
        return found
    mirrored = found._replace(system=with_poles_inside(found.system))
    if found.system.stable():
        return mirrored
    kept = searched(INTEGRATING + ROUNDED)
    kept = kept._replace(system=with_poles_inside(kept.system))

    def size(one: SystemFit) -> float:
        return data.samples * log_size(one.system.errors(data.u, data.y), options.weighted)

    least, better = min((size(kept), kept), (size(mirrored), mirrored), key=lambda sized: sized[0])
    ended = found.converged and least - size(found) <= AT_THE_EDGE
    return SystemFit(better.system, found.steps + kept.steps, ended)


def log_size(e: FloatArray, weighted: bool) -> float:
    """Return log det(e e' / n) of errors `(ny, n)`; not `weighted`, ny times the log of the mean trace in its place."""
    covariance = e @ e.T / e.shape[1]
    if not np.all(np.isfinite(covariance)):
        return np.inf
    least = np.finfo(float).tiny  # of a record without noise nothing is left
    if not weighted:
        return len(covariance) * float(np.log(max(np.trace(covariance) / len(covariance), least)))
    sign, value = np.linalg.slogdet(gauss_newton.propped(covariance))
    return float(value) if sign > 0 else len(covariance) * float(np.log(least))


def with_poles_inside(start: System) -> System:
    """Return the system with its poles inside the circle, all else as it was."""
    if np.abs(np.linalg.eigvals(start.A)).max() <= STABLE_RADIUS:
        return start
    values, vectors = np.linalg.eig(start.A)
    inside = poles_inside(values.astype(np.complex128))
    return replace(start, A=(vectors @ np.diag(inside) @ np.linalg.inv(vectors)).real)


def noise_gain(start: System, e: FloatArray, data: Scaled) -> FloatArray:
    """Return the gain `(n, ny)` of the innovations for a system whose other parts are held.

    The simulated error v = (C (zI - A)^-1 K + 1) e is linear in K once e is known; a first guess of e is given, later
    ones come from the round before (Hannan and Rissanen's regression). A round counts when it lowers the determinant of
    the one-step errors.
    """
    v = data.y - start.simulated(data.u)
    if np.all(np.mean(v**2, axis=1) <= NO_NOISE):  # of unit outputs: what is left is rounding, which has no colour
        return np.zeros_like(start.K)
    poles, directions, states = modes_of(start.A, start.C)
    best, loss = np.zeros_like(start.K), _spread(v)
    for _ in range(GAIN_ROUNDS):
        bank = modal_least_squares.FilterBank(poles, e, v, feedthrough=False, offset=False)
        gain = (states @ bank.fit_b(directions).b[:, :-1]).real
        tried = replace(start, K=gain)
        if not tried.predicts():
            break
        e = tried.errors(data.u, data.y)
        lower = _spread(e)
        if not lower < loss:
            break
        best, loss = gain, lower
    return best


def _spread(e: FloatArray) -> float:
    sign, value = np.linalg.slogdet(gauss_newton.propped(e @ e.T / e.shape[1]))
    return float(value) if sign > 0 and np.isfinite(value) else np.inf
