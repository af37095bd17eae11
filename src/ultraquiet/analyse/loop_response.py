"""A closed loop's response at single lines, also at poles of plant or controller, and its worst over a band."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, rising_band
from ultraquiet.analyse.margins import bounded_grid, bounded_response, default_grid, even_inputs
from ultraquiet.analyse.peaks import refined, response_at
from ultraquiet.analyse.plant_scale import unit_peaks
from ultraquiet.linalg.norms import largest_gains
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import lft, sensitivity
from ultraquiet.values.joined.wires import unswapped
from ultraquiet.values.state_space import StateSpace

# Size of an entry of G K above which I - G K has lost half of its digits: of rank one, it would be singular at twice.
LOST = 1e8
REACHED = 1e-6  # of the strongest direction's gain: a weaker one is rounding
SPARSE = 20  # of the lines of a grid, one of so many tells how large a channel's gains are
BAND_LINES = 400  # over a band that is asked for, besides those of the poles


@takes_systems
def loop_response(plant: StateSpace, controller: StateSpace, f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return S = (I - G K)^-1 and K S at each line.

    A line on a pole of G or K, as 0 Hz of an integrator, has a loop without bound, and yet S is as ordinary there as
    anywhere: it is taken from the closed loop's own matrices.

    Args:
        plant: G.
        controller: K, its sign inside.
        f_hz: `(nf,)`, Hz.

    Returns:
        `(nf, ny, ny)` and `(nf, nu, ny)`.

    >>> from ultraquiet.values.interconnect import gain
    >>> integrator = StateSpace([[1.0]], [[0.1]], [[1.0]], [[0.0]], rate_hz=10.0)
    >>> S, KS = loop_response(integrator, gain([[-1.0]], 10.0), np.array([0.0, 5.0]))
    >>> np.round(np.abs(np.ravel([S, KS])), 3).tolist()
    [0.0, 1.053, 0.0, 1.053]
    """
    G, K = _responses(plant, controller)(f_hz)
    S, lost = _inverted(G, K)
    with np.errstate(invalid="ignore"):
        KS = K @ S
    if lost.any():
        closed = np.moveaxis(closed_system(plant, controller).frequency_response(f_hz[lost]), 2, 0)
        S[lost], KS[lost] = np.split(closed, [S.shape[1]], axis=1)
    return S, np.asarray(KS, dtype=np.complex128)


def both_sensitivities(
    plant: StateSpace, controller: StateSpace
) -> Callable[[FloatArray], tuple[ComplexArray, ComplexArray]]:
    """Return what gives (I - K G)^-1 and (I - G K)^-1 at lines in Hz, `(nf, nu, nu)` and `(nf, ny, ny)`.

    As `loop_response` does; to be asked as often as wanted.
    """
    at = _responses(plant, controller)

    def both(f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        G, K = at(f_hz)
        return _sensitivity(controller, plant, f_hz, K, G), _sensitivity(plant, controller, f_hz, G, K)

    return both


def _responses(plant: StateSpace, controller: StateSpace) -> Callable[[FloatArray], tuple[ComplexArray, ComplexArray]]:
    """Return what gives G and K at lines, `(nf, ny, nu)` and `(nf, nu, ny)`."""
    unswapped("loop", controller, plant)
    of_plant, of_law = response_at(plant), response_at(controller)

    def at(f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.moveaxis(of_plant(f_hz), 2, 0), np.moveaxis(of_law(f_hz), 2, 0)

    return at


def _inverted(G: ComplexArray, K: ComplexArray) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Return (I - G K)^-1 at each line, and the lines at which it is lost."""
    with np.errstate(invalid="ignore", over="ignore"):
        L = G @ K
        lost = ~(np.abs(L).max(axis=(1, 2), initial=0.0) < LOST)
    L[lost] = 0.0
    return np.asarray(np.linalg.inv(np.eye(L.shape[1]) - L), dtype=np.complex128), lost


def _sensitivity(
    first: StateSpace, second: StateSpace, f_hz: FloatArray, G: ComplexArray, K: ComplexArray
) -> ComplexArray:
    S, lost = _inverted(G, K)
    if lost.any():
        S[lost] = np.moveaxis(sensitivity(first, second).frequency_response(f_hz[lost]), 2, 0)
    return S


def closed_system(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return [S; K S], from a disturbance at the plant's output: `ny + nu` outputs, `ny` inputs."""
    ny, nu = plant.D.shape
    B = np.hstack([np.zeros((plant.states, ny)), plant.B])
    C = np.vstack([plant.C, np.zeros((nu, plant.states)), plant.C])
    D = np.block([[np.eye(ny), plant.D], [np.zeros((nu, ny)), np.eye(nu)], [np.eye(ny), plant.D]])
    return lft(StateSpace(plant.A, B, C, D, plant.rate_hz), controller, measurements=ny, controls=nu)


@takes_systems
def band_attenuation(plant: StateSpace, controller: StateSpace, band_hz: tuple[float, float]) -> tuple[float, float]:
    """Return by how much a loop attenuates its worst direction over a band, and where that is least.

    -20 log10 max over f in the band of the largest singular value of S = (I - G K)^-1, u = K y. S is taken over the
    directions that the inputs reach, the range of G(f): others no law can attenuate, as some
    of any plant with more outputs than inputs.

    Args:
        plant: G.
        controller: K, its sign inside.
        band_hz: (low, high) in Hz, below the Nyquist frequency.

    Returns:
        `(attenuation_db, f_hz)`: decibels, negative where the worst direction is amplified, and its frequency in Hz;
        minus infinity and NaN for an unstable loop.

    Raises:
        InputError: a band that does not rise or lies beyond the Nyquist frequency; shapes that do not fit.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> [round(v, 2) for v in band_attenuation(G, K, (1.0, 5.0))]
    [5.24, 5.0]

    Reference: Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., section 3.3.
    """
    low, high = rising_band("band_attenuation", band_hz, plant.rate_hz)
    G, K = even_inputs(plant, controller)
    S = sensitivity(G, K)
    if not S.is_stable():
        return -np.inf, np.nan
    reached_at = reached_directions(G)
    largest, at = largest_in_band(S, plant, (low, high), lambda S, lines: S @ reached_at(lines))
    return -20 * float(np.log10(max(largest, np.finfo(float).tiny))), at


def largest_in_band(
    S: StateSpace, plant: StateSpace, band_hz: tuple[float, float], seen: Callable[[ComplexArray, FloatArray], Any]
) -> tuple[float, float]:
    """Return the largest singular value of a loop's response over a band, and its frequency in Hz.

    Features of a loop are as narrow as its poles and the plant's are: what lies between evenly spaced lines is found.

    Args:
        S: the loop.
        plant: G.
        band_hz: (low, high) in Hz.
        seen: gives what counts of S `(lines, ny, ny)` at these lines in Hz, `(lines, rows, columns)`.
    """
    low, high = band_hz
    f = np.concatenate([default_grid(S), default_grid(plant), np.geomspace(low, high, BAND_LINES)])
    f = np.unique(f[(f >= low) & (f <= high)])
    of_loop = response_at(S)

    def sizes(lines: FloatArray) -> FloatArray:
        return largest_gains(seen(np.moveaxis(of_loop(lines), 2, 0), lines))

    return refined(sizes, f, sizes(f))


def reached_directions(plant: StateSpace) -> Callable[[FloatArray], ComplexArray]:
    """Return what gives the directions that a plant's inputs reach at frequencies in Hz, also at those of its poles.

    How many there are is asked in units in which every channel has the same largest gain: a sensor in units a million
    times as large is not out of reach. The range of G(f) itself is that of the units given.

    Returns:
        An orthonormal basis of the range of G(f), `(lines, ny, min(ny, nu))`, columns of zeros where its rank is less.
    """
    of_plant = bounded_response(plant)
    y, u = unit_peaks(np.moveaxis(np.abs(of_plant(bounded_grid(plant)[::SPARSE])) ** 2, 2, 0))
    y = y[:, None]

    def at(f: FloatArray) -> ComplexArray:
        directions, gains, _ = np.linalg.svd(np.moveaxis(of_plant(f), 2, 0) * y * u, full_matrices=False)
        reached = (gains > REACHED * gains[:, :1])[:, None, :]
        # largest first: what is not reached comes last and spans nothing
        basis, _ = np.linalg.qr(directions * reached / y)
        return basis * reached

    return at
