"""A sum of modes of rank one, H(z) = sum_k c_k b_k' / (z - p_k), fitted to samples: poles and directions together.

A mode of a structure has one shape at the sensors and one at the actuators: its residue has rank one, and it costs two
states. Levenberg and Marquardt's steps on all of p, c and b. Since the weight of a line is the same for every channel,
their normal matrix follows from Gram matrices of the functions 1 / (z - p) and 1 / (z - p)^2 alone; its cost does not
grow with channels times lines (`projected_step`).
"""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.modes.projected_step import ProjectedEquations

# Damping of the steps: first, least (c and b share a factor: the matrix is singular), and where the search ends.
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e3
EASED, STIFFENED = 0.2, 8.0
GAIN = 1e-4  # share of the cost that a step must take for another to follow
HELD = 100.0  # weight of a known zero, in units of all lines together; a last exact step removes what is left


class RankOneModes(NamedTuple):
    """Poles of the upper half plane, their conjugates, real ones, `(m,)`; `c` `(ny, m)` and `b` `(m, nu)` likewise."""

    poles: ComplexArray
    c: ComplexArray
    b: ComplexArray

    @property
    def upper(self) -> int:
        """Number of complex pairs."""
        return int(np.count_nonzero(self.poles.imag > 0))

    def response(self, z: ComplexArray) -> ComplexArray:
        """Return `(ny, nu, nf)`."""
        return np.asarray(
            (self.c[:, None] * self.b.T).reshape(-1, self.poles.size) @ functions(self.poles, z).T
        ).reshape(len(self.c), self.b.shape[1], -1)

    def only(self, kept: np.ndarray) -> "RankOneModes":
        """Return the modes whose upper or real pole is among `kept`, indices from `heads`."""
        u = self.upper
        rows = np.concatenate([kept[kept < u], kept[kept < u] + u, kept[kept >= 2 * u]]).astype(int)
        return RankOneModes(self.poles[rows], self.c[:, rows], self.b[rows])

    def turned(self) -> "RankOneModes":
        """Return the modes of the transposed response."""
        return RankOneModes(self.poles, self.b.T, self.c.T)

    def heads(self) -> np.ndarray:
        """Return the indices of upper and real poles: one a mode."""
        u = self.upper
        return np.concatenate([np.arange(u), np.arange(2 * u, self.poles.size)])


class Samples(NamedTuple):
    """Points on the circle `(nf,)`, samples `(ny, nu, nf)`, a weight `(nf,)` for all channels, zeros known at z = 1."""

    z: ComplexArray
    H: ComplexArray
    weight: FloatArray
    zeros_at_one: int = 0
    slowest: float = 0.0  # least |ln p| of a pole: of what lies below the lowest sample nothing is known

    def error(self, modes: RankOneModes) -> float:
        """Return the weighted RMS error."""
        return self.rms(self.errors(modes))

    def rms(self, errors: FloatArray) -> float:
        """Return the RMS error over samples and channels that errors of each sample come to."""
        return float(np.sqrt(np.mean(errors**2) / (self.H.shape[0] * self.H.shape[1])))

    def errors(self, modes: RankOneModes) -> FloatArray:
        """Return the weighted error of each sample, the root of the sum of squares over its channels: `(nf,)`."""
        return over_channels(self.weight * (modes.response(self.z) - self.H))


def over_channels(values: ComplexArray) -> FloatArray:
    """Return the root of the sum of squares of `(ny, nu, nf)` at each sample: `(nf,)`."""
    return np.sqrt(np.sum(np.abs(values) ** 2, axis=(0, 1)))


def of(poles: ComplexArray, c: ComplexArray, b: ComplexArray) -> RankOneModes:
    """Return modes from upper and real poles alone, in any order."""
    real = poles.imag == 0
    up, on = np.flatnonzero(~real), np.flatnonzero(real)
    return RankOneModes(
        np.concatenate([poles[up], poles[up].conj(), poles[on]]),
        np.hstack([c[:, up], c[:, up].conj(), c[:, on].real]).astype(np.complex128),
        np.vstack([b[up], b[up].conj(), b[on].real]).astype(np.complex128),
    )


def refined(modes: RankOneModes, samples: Samples, steps: int, enough: float = 0.0) -> RankOneModes:
    """Return modes of less weighted error, poles inside the circle, zeros at z = 1 exact.

    Args:
        modes: where to begin.
        samples: what to meet.
        steps: taken at most.
        enough: RMS error at which the search may end.
    """
    if len(modes.c) < modes.b.shape[1]:  # a step costs by the inputs alone
        turned = samples._replace(H=samples.H.transpose(1, 0, 2))
        return refined(modes.turned(), turned, steps, enough).turned()
    at = FittedModes.of(modes, samples)
    damping = DAMPING
    for _ in range(steps):
        if at.cost <= enough**2 * samples.H.size:
            break
        equations = ProjectedEquations.of(at.modes.c, at.modes.b, at.modes.upper, at.phi, at.psi, at.left)
        last, eased = at.cost, EASED
        while damping < MOST_DAMPING:
            trial = _stepped(at, equations, damping)
            if trial is not None and trial.cost < at.cost:
                at, damping = trial, max(damping * eased, LEAST_DAMPING)
                break
            damping, eased = damping * STIFFENED, 1.0
        if last - at.cost <= GAIN * last:
            break
    return fitted_outputs(at.modes, samples)


def fitted_outputs(modes: RankOneModes, samples: Samples) -> RankOneModes:
    """Return the modes with the output directions c of least error, zeros at z = 1 exact where they can be."""
    u, m = modes.upper, modes.poles.size
    phi = samples.weight[:, None] * functions(modes.poles, samples.z)
    X = real_columns((phi[:, None] * modes.b.T).reshape(-1, m), u)
    wanted = (samples.weight * samples.H).transpose(2, 1, 0).reshape(len(X), -1)
    X, y = np.concatenate([X.real, X.imag]), np.concatenate([wanted.real, wanted.imag])
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    free = np.eye(m)
    if samples.zeros_at_one:
        powers = 1.0 / (1.0 - modes.poles) ** np.arange(1, samples.zeros_at_one + 1)[:, None]
        rows = real_columns((powers[:, None] * modes.b.T).reshape(-1, m), u).real / size
        _, s, Vh = np.linalg.svd(rows)
        free = Vh[int(np.count_nonzero(s > s[0] * np.finfo(float).eps * max(rows.shape))) :].T
    x = (free @ np.linalg.lstsq(X / size @ free, y, rcond=None)[0]) / size[:, None]
    c = x[:u] + 1j * x[u : 2 * u]
    return RankOneModes(modes.poles, np.vstack([c, c.conj(), x[2 * u :]]).T.astype(np.complex128), modes.b)


def weighted(poles: ComplexArray, samples: Samples) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return 1 / (z - p) and its slope by p `(lines, m)`, and samples, all weighted; a known zero is a heavy line."""
    plain = functions(poles, samples.z)
    phi = samples.weight[:, None] * plain
    psi = phi * plain
    H = np.asarray(samples.weight * samples.H, dtype=np.complex128)
    if samples.zeros_at_one:
        near = 1.0 - poles
        powers = np.arange(1, samples.zeros_at_one + 1)[:, None]
        # 1 / |z - 1| of the lowest line is about what a slow pole has at most, there and at z = 1
        heavy = HELD * np.linalg.norm(samples.weight) * np.abs(samples.z[0] - 1.0) ** (powers - 1.0)
        phi = np.vstack([phi, heavy / near**powers])
        psi = np.vstack([psi, heavy * powers / near ** (powers + 1.0)])
        H = np.concatenate([H, np.zeros((*H.shape[:2], samples.zeros_at_one), dtype=np.complex128)], axis=2)
    return phi, psi, H


class FittedModes(NamedTuple):
    """Modes with what they leave of the weighted samples, and its sum of squares."""

    modes: RankOneModes
    samples: Samples
    phi: ComplexArray
    psi: ComplexArray
    left: ComplexArray
    cost: float

    @classmethod
    def of(cls, modes: RankOneModes, samples: Samples) -> "FittedModes":
        """Evaluate the modes."""
        phi, psi, H = weighted(modes.poles, samples)
        gains = (modes.c[:, None] * modes.b.T).reshape(-1, modes.poles.size)
        left = H - (gains @ phi.T).reshape(H.shape)
        return cls(modes, samples, phi, psi, left, float(np.sum(np.abs(left) ** 2)))


def _stepped(at: FittedModes, equations: ProjectedEquations, damping: float) -> FittedModes | None:
    step = equations.step(damping)
    if step is None:
        return None
    u, (p, c, b), (dp, dc, db) = at.modes.upper, at.modes, step
    # a pole that would leave its bounds, or its half of the plane, stays: one of them must not hold all the others
    there = p[at.modes.heads()] + dp
    free = _within(there, at.samples.slowest) & ((np.arange(dp.size) >= u) | (there.imag > 0))
    dp = np.where(free, dp, 0.0)
    moved = RankOneModes(
        p + np.concatenate([dp[:u], dp[:u].conj(), dp[u:]]),
        c + np.concatenate([dc[:, :u], dc[:, :u].conj(), dc[:, u:]], axis=1),
        b + np.concatenate([db[:u], db[:u].conj(), db[u:]]),
    )
    return FittedModes.of(moved, at.samples) if np.all(_within(moved.poles, at.samples.slowest)) else None


def _within(poles: ComplexArray, slowest: float) -> np.ndarray:
    """Return which poles are inside the circle, not at the origin, and no slower than lines tell."""
    size = np.abs(poles)
    inside = (size > 0.0) & (size < 1.0)
    return inside & (np.abs(np.log(np.where(inside, poles, 1.0))) >= 0.999 * slowest)


def functions(poles: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Return 1 / (z - p), `(nf, m)`."""
    return np.asarray(1.0 / (z[:, None] - poles))


def real_columns(X: ComplexArray, upper: int) -> ComplexArray:
    """Return columns of real unknowns x, y for those of v = x + iy and its conjugate, which come first."""
    one, other = X[:, :upper], X[:, upper : 2 * upper]
    return np.concatenate([one + other, 1j * (one - other), X[:, 2 * upper :]], axis=1)


def real_rows(X: ComplexArray, upper: int) -> FloatArray:
    """Return the real part of products with those columns, from the rows of products with v and its conjugate."""
    one, other = X[:upper], X[upper : 2 * upper]
    return np.concatenate([one.real + other.real, one.imag - other.imag, X[2 * upper :].real])
