"""A plant sampled where a loop around it is judged: its response at lines, and the poles of the loop."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.loop_response import REACHED
from ultraquiet.analyse.peaks import response_at
from ultraquiet.design.law_structure.plane import Plane
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace

SHARP = 0.2  # poles of less damping get lines of their own
FAN = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])  # of those lines, in half widths of the pole
NEAR = 0.25  # of a half width: a line as near as this shows the mode already
# A pole of less damping has no response at its own frequency, and nearer than so much of it the loop's is rounding.
ON_AXIS, BESIDE = 1e-9, 1e-3
NEAREST = 1e-7  # lines closer than this, relatively, are one


def _about(poles: ComplexArray, fan: FloatArray) -> FloatArray:
    """Return lines about poles, so many half widths away."""
    return (poles.imag[:, None] + np.abs(poles.real)[:, None] * fan).ravel()


class Scenario:
    """One plant, in the scales of the search.

    Args:
        plant: G.
        plane: in which the law lives.
        f_hz: lines, besides those that the plant's own poles need.
        band_hz: in which S counts over the directions that inputs reach; (0, 0) for nowhere.
        fan: where the lines about its poles lie, in half widths.
    """

    def __init__(
        self, plant: StateSpace, plane: Plane, f_hz: FloatArray, band_hz: tuple[float, float], fan: FloatArray = FAN
    ) -> None:
        self.plant, self.plane, self.band_hz = plant, plane, band_hz
        self.loop: Matrices = plane.to_plane(plant)
        self._at = response_at(plant)
        own = self._modes(
            np.linalg.eigvals(self.loop[0]).astype(np.complex128) if plant.states else np.zeros(0, complex)
        )
        undamped = np.abs(own.real) <= ON_AXIS * np.abs(own)
        fan = np.concatenate([_about(own[~undamped], fan), _about(own[undamped] * (1 + 1j * BESIDE), fan[fan != 0])])
        self.w = np.zeros(0)
        self.f_hz = np.zeros(0)
        self.G = np.zeros((0, *plant.D.shape), dtype=np.complex128)
        self.reached = np.zeros((0, plant.D.shape[0], min(plant.D.shape)), dtype=np.complex128)
        self.add(np.concatenate([plane.of_hz(f_hz), fan[fan > 0]]))

    def add(self, w: FloatArray) -> bool:
        """Take more lines, places in the plane; return whether any was new."""
        merged = np.unique(np.concatenate([self.w, w]))
        merged = merged[np.concatenate([[True], np.diff(merged) > NEAREST * merged[1:]])]
        kept = np.isin(self.w, merged)
        new = merged[~np.isin(merged, self.w[kept])]
        if not new.size:
            return False
        f = self.plane.hz(new)
        G = self.response(f)
        reached = np.zeros((new.size, G.shape[1], min(G.shape[1:])), dtype=np.complex128)
        inside = (f >= self.band_hz[0] * (1 - NEAREST)) & (f <= self.band_hz[1] * (1 + NEAREST))
        reached[inside] = self.directions(G[inside])
        joined = np.concatenate([self.w[kept], new])
        order = np.argsort(joined)
        self.w, self.f_hz = joined[order], np.concatenate([self.f_hz[kept], f])[order]
        self.G = np.concatenate([self.G[kept], G])[order]
        self.reached = np.concatenate([self.reached[kept], reached])[order]
        return True

    def response(self, f_hz: FloatArray) -> ComplexArray:
        """Return G, `(lines, outputs, inputs)`."""
        return np.moveaxis(self._at(f_hz), 2, 0)

    @staticmethod
    def directions(G: ComplexArray) -> ComplexArray:
        """Return orthonormal columns that span what inputs reach at each line: all of it, unless outputs are more."""
        if G.shape[1] <= G.shape[2]:
            return np.broadcast_to(np.eye(G.shape[1], dtype=np.complex128), (len(G), G.shape[1], G.shape[1]))
        U, gains, _ = np.linalg.svd(G, full_matrices=False)
        return np.asarray(U * (gains > REACHED * gains[:, :1])[:, None, :], dtype=np.complex128)

    def poles(self, law: Matrices) -> ComplexArray:
        """Return the poles of the loop in the plane."""
        A, B, C, D = self.loop
        a, b, c, d = law
        E = np.linalg.solve(np.eye(D.shape[0]) - D @ d, np.hstack([C, D @ c]))
        n = A.shape[0]
        U = d @ E + np.hstack([np.zeros((D.shape[1], n)), c])
        top = np.hstack([A, np.zeros((n, a.shape[0]))]) + B @ U
        low = np.hstack([np.zeros((a.shape[0], n)), a]) + b @ E
        return np.linalg.eigvals(np.vstack([top, low])).astype(np.complex128)

    def look(self, poles: ComplexArray) -> bool:
        """Take the lines at which modes of a loop would show and that are not there; return whether any was new."""
        modes = self._modes(poles)
        if not modes.size:
            return False
        k = np.clip(np.searchsorted(self.w, modes.imag), 1, self.w.size - 1)
        distance = np.minimum(np.abs(self.w[k] - modes.imag), np.abs(self.w[k - 1] - modes.imag))
        return self.add(modes.imag[distance > NEAR * np.abs(modes.real)])

    @staticmethod
    def _modes(poles: ComplexArray) -> ComplexArray:
        """Return the poles that may make a narrow peak, one of each pair."""
        return poles[(poles.imag > 0) & (np.abs(poles.real) < SHARP * np.abs(poles))]
