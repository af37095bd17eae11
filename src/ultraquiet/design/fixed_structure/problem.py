"""What a controller of fixed structure is tuned against: bounds on closed-loop gains over frequency, with their slopes.

The plant enters as samples on the frequency axis, so that a probe costs small matrices whatever the plant's order
(Apkarian and Noll 2018, doi:10.1002/rnc.4073); stability is judged by the poles of the loop, and the grid is refined at
the peaks and closed-loop poles of what was found until no peak between its points is left.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.law_structure.controller_structure import ControllerStructure
from ultraquiet.design.law_structure.plane import AT_REST, SAME, plane_of
from ultraquiet.linalg.modal_response import residues
from ultraquiet.values.state_space import StateSpace

POINTS = 220  # of the first grid
MARGIN = 1e-9  # a loop counts as stable when its slowest pole is this far inside, relative to its size
INFINITE = 1e6  # stands for infinite frequency, times the fastest pole
ON_AXIS = 1e-9  # relative to its size, a pole with less damping has no response at its own frequency
BESIDE = 1e-3  # relative; nearer to such a pole the plant's response is so large that the loop's drowns in rounding
UNMOVED = 1e-5  # of its frequency: an undamped mode that the loop moves less it does not damp
SHARP = 0.05  # resonances of less damping may hide between the points of the grid
HIDDEN = 1.01  # a peak higher than all points by this factor was hidden
TOPS = 20  # hidden peaks that one look adds
EXTRA, FAR = 200, 0.7  # points beyond the first grid that are kept at most, unless they reach this share of the top
FAN = np.array([0.99, 1.0, 1.01])


@dataclass(frozen=True, eq=False)
class Requirement:
    """The largest singular value of some rows of F(P, K) over a bound.

    Args:
        name: what it is called in reports.
        rows: of the performance outputs of P.
        bound: allowed gain at frequencies in Hz, infinity where nothing is asked; one everywhere when absent.
        hard: must be met; what is not hard is made as small as hard ones allow.
    """

    name: str
    rows: slice
    bound: Callable[[FloatArray], FloatArray] | None = None
    hard: bool = False


@dataclass(frozen=True, eq=False)
class PlantSamples:
    """P at the points of a grid, frequency first, and the bound of every requirement there."""

    w: FloatArray
    P11: ComplexArray
    P12: ComplexArray
    P21: ComplexArray
    P22: ComplexArray
    bounds: tuple[FloatArray, ...]


class TuningProblem:
    """A generalised plant, requirements on it, a structure, and the loop whose poles decide.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y).
        plant: what u drives and y reads, its states alone deciding stability.
        structure: the controller's.
        requirements: on rows of z.
        stable_law: whether the controller itself must be stable.
        more_hz: frequencies that the grid must hold.
    """

    def __init__(
        self,
        P: StateSpace,
        plant: StateSpace,
        structure: ControllerStructure,
        requirements: tuple[Requirement, ...],
        stable_law: bool = True,
        more_hz: FloatArray | None = None,
    ) -> None:
        self.structure, self.requirements, self.stable_law = structure, requirements, stable_law
        self.plane = plane_of(P)
        self.ny, self.nu = plant.D.shape
        M = self.plane.to_plane(P)
        self._terms = residues(*M)
        self.loop = self.plane.to_plane(plant)
        poles = np.linalg.eigvals(M[0])
        self._on_axis = poles[
            np.abs(poles.real) <= ON_AXIS * np.maximum(np.abs(poles), ON_AXIS * np.abs(poles).max(initial=0))
        ]
        named = np.zeros(0) if more_hz is None else self.plane.of_hz(more_hz)
        # poles of the plane have a size about one; what is far below is an integrator, moved by rounding
        size = np.concatenate([np.abs(poles)[np.abs(poles) > AT_REST * max(np.abs(poles).max(initial=0), 1)], named])
        size = size if size.size else np.ones(1)  # a static plant, or integrators alone
        self.low, self.high = float(size.min()), float(size.max())
        if P.rate_hz is not None:
            self.low, self.high = max(self.low, 1e-5), min(self.high, 1.0)
        self.soft = 1.0  # weight of what is not hard
        ends = np.concatenate([np.geomspace(self.low / 10, self.high * 10, POINTS), [0.0, INFINITE * self.high]])
        self.samples = self.sampled(np.concatenate([ends, np.abs(poles.imag), named]))
        self._base = self.samples.w

    def sampled(self, w: FloatArray) -> PlantSamples:
        """Return P and the bounds at frequencies of the plane."""
        w = self._beside(w)
        R = np.moveaxis(self._terms.at(_axis(w)), 2, 0)
        p, m = R.shape[1] - self.ny, R.shape[2] - self.nu
        f = self.plane.hz(w)
        bounds = tuple(np.ones(w.size) if r.bound is None else r.bound(f) for r in self.requirements)
        return PlantSamples(w, R[:, :p, :m], R[:, :p, m:], R[:, p:, :m], R[:, p:, m:], bounds)

    def _beside(self, w: FloatArray) -> FloatArray:
        """Return points, those at a pole of the plant on the axis moved beside it: there only the loop has a response.

        Left out, they would be a gap: a search finds laws whose loop is worst just there.
        """
        for at in np.abs(self._on_axis.imag):
            near = BESIDE * max(float(at), self.low)
            w = np.where(np.abs(w - at) <= near, at + near, w)
        w = np.unique(w)
        return w[np.append(True, np.diff(w) > SAME * w[1:])[: w.size]]

    def refine(self, theta: FloatArray) -> float:
        """Add what a fine grid shows between the points; return by how much the level was underrated, relative."""
        before = self.level(theta, self.samples)
        w = self.samples.w
        between = np.sqrt(w[1:-2] * w[2:-1])
        poles = self._poles(theta)
        own = np.concatenate([np.abs(poles.imag), np.abs(poles)])
        near = (np.abs(poles.imag[:, None]) + np.abs(poles.real[:, None]) * np.linspace(-1, 1, 5)).ravel()
        extra = np.concatenate([between, own, near])
        extra = extra[(extra > 0) & (extra < w[-1])]
        fine = self.sampled(extra)
        levels = np.max(self._levels(theta, fine), axis=0)
        top = max(before, float(levels.max(initial=0.0)))
        near = np.flatnonzero(_tops(levels) & (levels > 0.8 * top))
        keep = fine.w[near[np.argsort(-levels[near])[:TOPS]]]
        if keep.size:
            around = (keep[:, None] * np.array([0.98, 0.99, 1.0, 1.01, 1.02])).ravel()
            self._add(theta, around)
        return top / before - 1 if before > 0 else 0.0

    def weights(self) -> FloatArray:
        """Return the factor on each requirement."""
        return np.array([1.0 if r.hard else self.soft for r in self.requirements])

    def level(self, theta: FloatArray, samples: PlantSamples | None = None) -> float:
        """Return the greatest of all requirements over the grid."""
        levels = self._levels(theta, samples or self.samples)
        return float(np.max(levels * self.weights()[:, None]))

    def measured(self, theta: FloatArray) -> FloatArray:
        """Return the level of each requirement; infinite where law and plant close a loop that is singular at once."""
        try:
            return self._levels(theta, self.samples).max(axis=1)
        except np.linalg.LinAlgError:
            return np.full(len(self.requirements), np.inf)

    def mean_db(self, theta: FloatArray) -> float:
        """Return the mean over the grid of the first requirement's level in dB, where it asks for anything."""
        asked = np.isfinite(self.samples.bounds[0])
        levels = self._levels(theta, self.samples)[0, asked]
        return float(np.mean(20 * np.log10(np.maximum(levels, SAME))))

    def value(self, theta: FloatArray, ceiling: float = np.inf) -> float:
        """Return the level, or infinity when the loop is unstable; poles are taken only of levels below the ceiling."""
        if not np.all(np.isfinite(theta)):
            return np.inf
        try:
            each = self._levels(theta, self.samples).max(axis=1)
            level = float(np.max(each * self.weights()))
            if level >= ceiling:
                return level
            poles = self._poles(theta)
            return max(level, self._between(theta, poles, each)) if self._stable(theta, poles) < 0 else np.inf
        except np.linalg.LinAlgError:
            return np.inf

    def stability(self, theta: FloatArray) -> float:
        """Return the largest real part of the loop's poles, and of the law's own where these count, over their size."""
        return self._stable(theta, self._poles(theta))

    def _stable(self, theta: FloatArray, poles: ComplexArray) -> float:
        worst = float(np.max(poles.real / (np.abs(poles) + SAME), initial=-1.0)) + MARGIN
        if self._unmoved(poles):
            worst = max(worst, MARGIN)
        return max(worst, self.structure.abscissa(theta) + MARGIN) if self.stable_law else worst

    def _unmoved(self, poles: ComplexArray) -> bool:
        """Return whether the loop leaves a pole of the plant on the axis where it is, too near for its peak to show."""
        for at in self._on_axis:
            own = BESIDE * self.low if abs(at) <= self.low * BESIDE else UNMOVED * abs(at)
            if np.any(np.abs(poles - at) < own):
                return True
        return False

    def _poles(self, theta: FloatArray) -> ComplexArray:
        return np.linalg.eigvals(self.closed(theta)).astype(np.complex128)

    def _between(self, theta: FloatArray, poles: ComplexArray, each: FloatArray) -> float:
        """Return the level at resonances of the loop, and keep those points of the grid where it hid a peak.

        `each` is the greatest of every requirement on the grid; one that is hard and missed counts below the level too.
        """
        size = np.abs(poles)
        # where integrators close their loop nobody knows beforehand: a pole off the grid is looked at however damped
        off = ((size < self.low / 10) | (size > 10 * self.high)) & (size > 0)
        ringing = (poles.imag > 0) & (poles.real > -SHARP * poles.imag)
        w = np.concatenate([poles.imag[ringing], size[off]])
        fine = self.sampled(w)
        if not fine.w.size:
            return 0.0
        rows = self._levels(theta, fine)
        levels, level = np.max(rows * self.weights()[:, None], axis=0), float(np.max(each * self.weights()))
        hard = np.array([r.hard for r in self.requirements])
        missed = (rows > HIDDEN * np.maximum(each, 1.0)[:, None]) & hard[:, None]
        hidden = fine.w[(levels > HIDDEN * level) | np.any(missed, axis=0)]
        if hidden.size:
            around = (hidden[:, None] * FAN).ravel()
            self._add(theta, around)
        return float(levels.max())

    def _add(self, theta: FloatArray, w: FloatArray) -> None:
        """Put points into the grid; when it grows long, those go that matter little now and were not there at first."""
        kept = self.samples.w
        if kept.size > self._base.size + EXTRA:
            levels = np.max(self._levels(theta, self.samples) * self.weights()[:, None], axis=0)
            kept = np.concatenate([self._base, kept[levels > FAR * levels.max()]])
        self.samples = self.sampled(np.concatenate([kept, w]))

    def closed(self, theta: FloatArray) -> FloatArray:
        """Return the A of the loop."""
        A, B, C, D = self.loop
        a, b, c, d = self.structure.system(theta)
        E = np.linalg.solve(np.eye(self.ny) - D @ d, np.hstack([C, D @ c]))
        n = A.shape[0]
        U = d @ E + np.hstack([np.zeros((self.nu, n)), c])
        return np.vstack(
            [np.hstack([A, np.zeros((n, a.shape[0]))]) + B @ U, np.hstack([np.zeros((a.shape[0], n)), a]) + b @ E]
        )

    def slope_at(self, theta: FloatArray, f_hz: float) -> FloatArray:
        """Return the gradient of the greatest requirement at one frequency, of infinity a very high one."""
        w = self.plane.of_hz(f_hz) if np.isfinite(f_hz) else INFINITE * self.high
        samples, self.samples = self.samples, self.sampled(np.array([float(w)]))
        try:
            return self.gradient(theta)
        finally:
            self.samples = samples

    def gradient(self, theta: FloatArray) -> FloatArray:
        """Return the gradient of the greatest peak."""
        return self.peaks(theta, 0.0, 1)[1][0]

    def peaks(self, theta: FloatArray, share: float, most: int) -> tuple[FloatArray, FloatArray]:
        """Return the local peaks within a share of the greatest, `(m,)`, and their gradients, `(m, size)`."""
        S, weights = self.samples, self.weights()
        levels = self._levels(theta, S) * weights[:, None]
        top = levels.max()
        chosen = _chosen(levels, (1 - share) * top, most)
        at = np.array([k for _, _, k in chosen])
        K = self.structure.response(theta, _axis(S.w[at]))
        loop = np.linalg.inv(np.eye(self.ny) - S.P22[at] @ K)
        right, left = loop @ S.P21[at], S.P12[at] @ (np.eye(self.nu) + K @ loop @ S.P22[at])
        M = S.P11[at] + left @ K @ S.P21[at]
        lefts, rights, values = [], [], []
        for j, (_, i, k) in enumerate(chosen):
            rows = self.requirements[i].rows
            U, s, Vh = np.linalg.svd(M[j, rows])
            factor = weights[i] / S.bounds[i][k]
            for r in range(s.size if share > 0 else 1):
                if r and factor * s[r] < (1 - share) * top:
                    continue
                lefts.append(factor * (U[:, r].conj() @ left[j, rows]))
                rights.append(right[j] @ Vh[r].conj())
                values.append((factor * s[r], k))
        w = S.w[np.array([k for _, k in values])]
        slopes = self.structure.gradient(theta, _axis(w), np.array(lefts), np.array(rights)).real
        return np.array([v for v, _ in values]), slopes

    def _levels(self, theta: FloatArray, S: PlantSamples) -> FloatArray:
        """Return gain over bound of each requirement at each point, exact where it may matter and a bound elsewhere."""
        K = self.structure.response(theta, _axis(S.w))
        KE = K @ np.linalg.inv(np.eye(self.ny) - S.P22 @ K)
        M = S.P11 + S.P12 @ (KE @ S.P21)
        out = np.zeros((len(self.requirements), S.w.size))
        for i, r in enumerate(self.requirements):
            part = M[:, r.rows]
            with np.errstate(divide="ignore"):
                out[i] = np.sqrt(np.sum(np.abs(part) ** 2, axis=(1, 2))) / S.bounds[i]
        ranks = [min(r.rows.stop - r.rows.start, M.shape[2]) for r in self.requirements]
        least = max(
            float((out[i] / np.sqrt(n)).max() * w) for i, (n, w) in enumerate(zip(ranks, self.weights(), strict=True))
        )
        for i, (r, n) in enumerate(zip(self.requirements, ranks, strict=True)):
            if n > 1:
                near = out[i] * self.weights()[i] >= 0.5 * least
                out[i, near] = _largest(M[near][:, r.rows]) / S.bounds[i][near]
                out[i, ~near] /= np.sqrt(n)
        return out


def abscissa(problem: TuningProblem, theta: FloatArray) -> tuple[float, FloatArray]:
    """Return the largest real part of the loop's poles and its gradient, from the eigenvectors of the worst pole."""
    from scipy.linalg import eig

    A, B, C, D = problem.loop
    n = A.shape[0]
    decomposition: Any = eig(problem.closed(theta), left=True, right=True)
    values, left, right = decomposition
    k = int(np.argmax(values.real))
    s = values[[k]]
    K = problem.structure.response(theta, s)[0]
    y = np.linalg.solve(np.eye(problem.ny) - D @ K, C @ right[:n, k])
    u = np.linalg.solve((np.eye(problem.nu) - K @ D).T, B.T @ left[:n, k].conj())
    slope = problem.structure.gradient(theta, s, u[None], y[None])[0] / (left[:, k].conj() @ right[:, k])
    return float(values[k].real), slope.real


def _largest(M: ComplexArray) -> FloatArray:
    """Return the largest singular values, from the products: half of the digits are plenty at twice the speed."""
    tall = M.shape[1] > M.shape[2]
    square = M.conj().swapaxes(1, 2) @ M if tall else M @ M.conj().swapaxes(1, 2)
    return np.sqrt(np.linalg.eigvalsh(square)[:, -1])


def _chosen(levels: FloatArray, least: float, most: int) -> list[tuple[float, int, int]]:
    """Return (level, requirement, point) of the greatest local maxima above a level and of points between them."""
    tops, others = [], []
    for i, row in enumerate(levels):
        top, above = _tops(row), row >= least
        tops += [(float(row[k]), i, int(k)) for k in np.flatnonzero(top & above)]
        others += [(float(row[k]), i, int(k)) for k in np.flatnonzero(~top & above)]
    tops = sorted(tops, reverse=True)[:most]
    every = max(1, -(-len(others) // max(most - len(tops), 1)))
    return tops + (others[::every] if most > len(tops) else [])


def _axis(w: FloatArray) -> ComplexArray:
    """Return points of the imaginary axis."""
    return (1j * w).astype(np.complex128)


def _tops(levels: FloatArray) -> np.ndarray:
    """Return where a sequence has local maxima, its ends among them."""
    padded = np.concatenate([[-np.inf], levels, [-np.inf]])
    return (levels >= padded[:-2]) & (levels > padded[2:])
