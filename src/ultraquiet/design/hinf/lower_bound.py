"""What no controller can do at a single frequency: a lower bound on the H-infinity norm, from responses alone."""

from typing import NamedTuple

import numpy as np

from ultraquiet.design.hinf.riccati import NormalisedPlant, direct_terms, equation
from ultraquiet.linalg.modal_response import split
from ultraquiet.linalg.ordered import Array

# First looks this close in frequency (8 %) are one; resonances are looked at each.
DISTINCT = 0.08
SHARP = 0.05
AROUND = np.array([-1.0, 0.0, 1.0])  # half widths of a resonance at which it is looked at
ROUNDS = 10
FINE = 1e-6  # relative width to which the bound is sought
# An eigenvalue counts as imaginary below this share of its modulus; what it stands for is then judged by its gain.
AXIS_SHARE = 1e-4
ENDS = np.array([1.5, 3.0, 10.0, 100.0])
FAN = np.linspace(-1, 1, 17)
FANS = (4e-2, 4e-3, 5e-4, 6e-5)  # each narrower than the step of the one before
ROUND_OFF = 1e-12  # relative error of a response


class Bound(NamedTuple):
    """No controller gets the norm below `level`, because of frequency `w` (rad/s of the normalised plant)."""

    level: float
    w: float


def lower_bound(plant: NormalisedPlant) -> Bound:
    """Return the largest over w of the gains of P12_perp' P11 and P11 P21_perp, which no control reaches.

    Parrott's theorem at one frequency: min over Q of |P11 + P12 Q P21| is the larger of the two. The Hamiltonian of the
    state-feedback (filter) equation has the eigenvalue jw at a level equal to the first (second) gain, so that the
    search climbs as for a norm (Bruinsma and Steinbuch 1990): above the bound both equations can be solved. Every
    frequency gives a bound; the search need not be complete for the number to be one.
    """
    at = _Floor(plant)
    best = at.highest(_looks(np.linalg.eigvals(plant.A)), Bound(0.0, 0.0))
    for _ in range(ROUNDS if best.level > 0 else 0):
        for spread in FANS if best.w else ():
            best = at.highest(best.w * (1 + spread * FAN), best)
        before = best
        for name in ("X", "Y"):
            best = at.highest(_crossings(plant, best.level * (1 + FINE), name), best)
        if best.level <= before.level * (1 + FINE):
            break
    return best


def _crossings(plant: NormalisedPlant, level: float, name: str) -> Array:
    """Return the frequencies where the gain of one kind may equal a level, those between and some at either end."""
    A, G, Q = equation(plant, level, name)
    if not np.any(Q):
        return np.zeros(0)
    values = np.linalg.eigvals(np.block([[A, -G], [-Q, -A.T]]))
    w = np.unique(np.abs(values.imag[np.abs(values.real) <= AXIS_SHARE * np.abs(values)]))
    if not w.size:
        return w
    # beyond the last one the gain may stay above the level to infinity, below the first one to zero
    return np.concatenate([w, np.sqrt(w[:-1] * w[1:]), w[0] / ENDS, w[-1] * ENDS])


def _looks(poles: Array) -> Array:
    """Return zero, the poles' corner frequencies, their resonances and the flanks of those."""
    size = np.abs(poles[poles != 0])
    if not size.size:
        return np.zeros(1)
    apart = np.exp(np.unique(np.round(np.log(size) / DISTINCT)) * DISTINCT)
    sharp = poles[(poles.imag > 0) & (np.abs(poles.real) < SHARP * np.abs(poles))]
    flanks = sharp.imag[:, None] + np.abs(sharp.real)[:, None] * AROUND
    return np.unique(np.concatenate([[0.0], apart, flanks.ravel(), [1e-2 * size.min(), 1e2 * size.max()]]))


class _Floor:
    """The two bounds over frequency."""

    def __init__(self, plant: NormalisedPlant) -> None:
        D12, D21 = direct_terms(plant)
        D = np.block([[plant.D11, D12], [D21, np.zeros((D21.shape[0], D12.shape[1]))]])
        B, C = np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2])
        self._terms = split(plant.form._replace(A=plant.A, B=B, C=C), D)
        self._m, self._p = plant.B1.shape[1], plant.C1.shape[0]

    def highest(self, w: Array, best: Bound) -> Bound:
        """Return the best bound so far or a higher one among frequencies."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            response = np.moveaxis(self._terms.at(1j * w), 2, 0)
        fine = np.isfinite(response).all(axis=(1, 2))
        w, P = w[fine], response[fine]
        if not w.size:
            return best
        m, p = self._m, self._p
        P11, P12, P21 = P[:, :p, :m], P[:, :p, m:], P[:, p:, :m]
        level = np.maximum(_unreached(P12, P11), _unreached(_adjoint(P21), _adjoint(P11)))
        # a cancellation of large terms leaves their round-off, which bounds nothing
        level = level - ROUND_OFF * np.linalg.norm(P11, axis=(1, 2))
        k = int(np.argmax(level))
        return Bound(float(level[k]), float(w[k])) if level[k] > best.level else best


def _unreached(P12: Array, P11: Array) -> Array:
    """Return the gain of P11 into the outputs that P12 does not reach, for each frequency."""
    m = P12.shape[2]
    if P12.shape[1] <= m:
        return np.zeros(P12.shape[0])
    Q = np.linalg.qr(P12, mode="complete")[0]
    return np.linalg.norm(_adjoint(Q[:, :, m:]) @ P11, 2, axis=(1, 2))


def _adjoint(P: Array) -> Array:
    return np.conj(np.swapaxes(P, 1, 2))
