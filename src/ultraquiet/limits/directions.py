"""Directions of a plant of several channels, as scalar loops."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, rising_band
from ultraquiet.limits.certificate import outer
from ultraquiet.limits.circle import Circle
from ultraquiet.limits.half_plane import half_plane
from ultraquiet.limits.loops import AffineLoops
from ultraquiet.linalg import balance
from ultraquiet.linalg.modal_response import splitting
from ultraquiet.linalg.response import points
from ultraquiet.linalg.zeros import invariant_zeros
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

BAND_POINTS = 60
NEGLIGIBLE = 1e-6  # Hankel values below this share of the largest leave a direction's function
CIRCLE = 1 << 15  # points from 0 to pi on which the phase of a minimum-phase function is computed
OWN_SHARE = (
    0.5  # of the power that the best input vector moves: a direction that moves it by itself is driven by itself
)
NO_ANSWER = 1e-12  # a response this small beside the largest counts as that small
LONGEST_DELAY = 64  # samples
ROUNDED = 1e-9  # no answer above this share of the largest is taken for round-off
ALONE_DB = 300.0  # what leaves a direction lies below every digit of what stays


@takes_systems
def principal_directions(plant: StateSpace, band_hz: tuple[float, float]) -> FloatArray:
    """Return constant orthonormal directions, the columns, from the one the plant moves least over a band.

    Eigenvectors of the mean over the band of the real part of G G*, each frequency with the same weight.

    Args:
        plant: G.
        band_hz: the band's ends, Hz.

    Raises:
        InputError: a band that does not rise, or that ends beyond Nyquist.

    >>> G = StateSpace([[-1.0, 0.0], [0.0, -1.0]], np.eye(2), np.diag([3.0, 1.0]), np.zeros((2, 2)))
    >>> np.abs(principal_directions(G, (1.0, 10.0))).round(3).tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    band = rising_band("principal_directions", band_hz, plant.rate_hz)
    G = np.moveaxis(plant.frequency_response(np.geomspace(*band, BAND_POINTS)), 2, 0)
    power = G @ np.moveaxis(G.conj(), 1, 2)
    power = power / np.maximum(np.trace(power, axis1=1, axis2=2), np.finfo(float).tiny)[:, None, None]
    return np.linalg.eigh(power.mean(axis=0).real)[1]


def moved(plant: StateSpace, band_hz: tuple[float, float]) -> FloatArray:
    """Return the principal directions that the plant can move at once: no more than it has inputs.

    Where G has more outputs than inputs, each frequency has unit vectors n with n* G = 0, so n* S = n*: there no
    controller does anything, and the worst of all directions stays at 0 dB or above.
    """
    ny, nu = plant.D.shape
    return principal_directions(plant, band_hz)[:, max(ny - nu, 0) :]


def driven(plant: StateSpace, v: FloatArray, band_hz: tuple[float, float]) -> FloatArray:
    """Return the unit vector over the inputs that stands for v: the one that moves v' G most in the mean over the band.

    For a square plant v itself, as long as it moves v' G by a good share of that: where actuators are wired in another
    order than sensors it may not move it at all.
    """
    row = v @ np.moveaxis(plant.frequency_response(np.geomspace(*band_hz, BAND_POINTS)), 2, 0)
    row = row / np.maximum(np.linalg.norm(row, axis=1), np.finfo(float).tiny)[:, None]
    shares = np.real(row.conj().T @ row)
    largest, vectors = np.linalg.eigh(shares)
    square = plant.D.shape[0] == plant.D.shape[1]
    return v if square and v @ shares @ v >= OWN_SHARE * largest[-1] else vectors[:, -1]


def along(plant: StateSpace, v: FloatArray, w: FloatArray) -> StateSpace:
    """Return v' G w, with states of no account removed."""
    B, C = plant.B @ w[:, None], v[None, :] @ plant.C
    M = plant.A, B, C, v[None, :] @ plant.D @ w[:, None]
    if plant.D.shape == (1, 1) or not plant.is_stable():
        return StateSpace(*M, rate_hz=plant.rate_hz)
    M = balance.without_faint(M, NEGLIGIBLE, discrete=plant.rate_hz is not None)
    return StateSpace(*M, rate_hz=plant.rate_hz)


def coupling_db(plant: StateSpace, v: FloatArray, w: FloatArray, band_hz: tuple[float, float]) -> float:
    """Return how far at worst over the band what leaves the direction lies below what stays in it, dB."""
    G = np.moveaxis(plant.frequency_response(np.geomspace(*band_hz, BAND_POINTS)), 2, 0)
    own = np.abs(v @ G @ w)
    other = np.sqrt(np.maximum(np.linalg.norm(G @ w, axis=1) ** 2 - own**2, 0.0))
    levels = [20 * np.log10(np.maximum(size, np.finfo(float).tiny)) for size in (own, other)]
    return float(min((levels[0] - levels[1]).min(), ALONE_DB))


class AllActuators:
    """The loop of v' S v when every actuator may help: a bound for controllers of any structure.

    v' S v = 1 + (v' G)(Q v) with |Q v| <= |K S|: Q v is a column of stable functions, and (v' G)(Q v) = g q with a
    stable scalar q, |q| <= |K S|, where |g| = |v' G| and g keeps the delay and the zeros outside the stability region
    that all entries of v' G have in common. What g q can do is at least what (v' G)(Q v) can.
    """

    def __init__(self, plant: StateSpace, v: FloatArray, circle: Circle) -> None:
        self._circle = circle
        self._angles = np.linspace(0, np.pi, CIRCLE + 1)
        terms = splitting(plant.A, plant.B, v[None, :] @ plant.C, plant.rate_hz is not None)
        row = terms.beside(v[None, :] @ plant.D).at(points(circle.frequencies(self._angles), plant.rate_hz))
        size = np.linalg.norm(row[0], axis=0)
        self._log = np.log(np.maximum(size, NO_ANSWER * size.max()))
        self._phase = np.unwrap(np.angle(outer(np.exp(self._log))[: CIRCLE + 1]))
        self._zeros, self._delay = _common(plant, v)

    def __call__(self, f_hz: FloatArray) -> AffineLoops:
        """Return the lines in q."""
        angles = self._circle.angles(f_hz)
        size, phase = (np.interp(angles, self._angles, y) for y in (self._log, self._phase))
        w = np.exp(1j * angles)
        g = np.exp(size + 1j * phase)
        for zero in self._circle.roots(self._zeros):
            g = g * (1 / w - 1 / zero) / (1 - 1 / (w * zero.conj()))
        if self._delay:
            g = g * np.exp(-2j * np.pi * self._delay * f_hz / float(self._circle.rate_hz or 1.0))
        one = np.ones(f_hz.size, dtype=np.complex128)
        return AffineLoops(one, g, 0 * one, one)


def _common(plant: StateSpace, v: FloatArray) -> tuple[ComplexArray, int]:
    """Return the zeros outside the stability region, in the half-plane, and the samples of delay of v' G.

    The zeros are those of v' G without the delay, which is one of them at infinity: none is counted twice.
    """
    C, D = v[None, :] @ plant.C, v[None, :] @ plant.D
    delay = 0 if plant.rate_hz is None else _delay(plant, v)
    for _ in range(delay):  # z times C (z I - A)^-1 B
        C, D = C @ plant.A, C @ plant.B
    values = invariant_zeros(plant.A, plant.B, C, D)
    zeros = half_plane(values, plant.rate_hz)
    return zeros[np.isfinite(zeros) & (zeros.real > 0)], delay


def _delay(plant: StateSpace, v: FloatArray) -> int:
    """Return after how many samples v' G answers; `LONGEST_DELAY` at most, and no delay at all where it never does.

    Nothing is an answer this small beside the largest in that time, or that is round-off of the products it is the sum
    of. Neither has units, whatever those of the states.
    """
    C, D = v[None, :] @ plant.C, v[None, :] @ plant.D
    answers, sums = [np.abs(D)], [np.abs(v[None, :]) @ np.abs(plant.D)]
    bound = np.abs(v[None, :]) @ np.abs(plant.C)
    for _ in range(LONGEST_DELAY):
        answers.append(np.abs(C @ plant.B))
        sums.append(bound @ np.abs(plant.B))
        C, bound = C @ plant.A, bound @ np.abs(plant.A)
    largest = max(float(answer.max()) for answer in answers)
    for k, (answer, total) in enumerate(zip(answers, sums, strict=True)):
        rounding = np.minimum(NO_ANSWER * total, ROUNDED * largest)
        if np.any(answer > np.maximum(rounding, NO_ANSWER * largest)):
            return k
    return 0
