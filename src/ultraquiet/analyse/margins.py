"""How far a loop is from instability: peak sensitivity, loop-at-a-time margins, disk margins."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.peaks import ends, refined, response_at
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace

POINTS = 3000  # of the default grid; crossings are interpolated between its points
DECADES = 5.0  # the default grid's span below its upper end


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of each loop opened by itself, the others closed; every array is `(loops,)`.

    Attributes:
        gain_up_db: extra gain that the loop stands; infinity when no gain upsets it.
        gain_down_db: loss of gain it stands (a positive number).
        phase_deg: phase lag it stands at its gain crossings.
        delay_s: extra delay it stands, seconds.
        disk: alpha, the radius of the symmetric disk of joint gain and phase changes it stands (0 none, 2 all).
    """

    gain_up_db: FloatArray
    gain_down_db: FloatArray
    phase_deg: FloatArray
    delay_s: FloatArray
    disk: FloatArray


def peak_sensitivity(plant: StateSpace, controller: StateSpace) -> tuple[float, float]:
    """Return the largest amplification of the loop in dB and its frequency in Hz.

    20 log10 max over f of the largest singular value of S = (I - G K)^-1, u = K y.

    Args:
        plant: G.
        controller: K, its sign inside.

    Returns:
        `(peak_db, f_hz)`; infinity when the loop is unstable.

    Below 6 dB every loop keeps a gain margin of at least 2 and 29 degrees of phase, in every direction.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> [round(v, 3) for v in peak_sensitivity(G, K)]
    [3.522, 50.0]
    """
    gain, f_hz = hinf_norm(sensitivity(plant, controller))
    return (20 * float(np.log10(gain)) if np.isfinite(gain) else np.inf), f_hz


def loop_margins(
    plant: StateSpace, controller: StateSpace, side: str = "output", f_hz: ArrayLike | None = None
) -> Margins:
    """Return the margins of every loop, opened one at a time at the plant's outputs or inputs.

    The open loop i, others closed, is L_i = 1 / S_ii - 1 (negative feedback), with S = (I - G K)^-1 at the outputs and
    (I - K G)^-1 at the inputs.

    Args:
        plant: G.
        controller: K, u = K y.
        side: `output` or `input`.
        f_hz: grid in Hz on which crossings are sought; log-spaced up to Nyquist when absent.

    Returns:
        `Margins`; zeros everywhere for an unstable loop.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> round(float(loop_margins(G, K).gain_up_db[0]), 2)
    9.54
    """
    S = sensitivity(plant, controller) if side == "output" else sensitivity(controller, plant)
    loops = S.D.shape[0]
    if not S.is_stable():
        return Margins(*(np.zeros(loops) for _ in range(5)))
    f = default_grid(S) if f_hz is None else grid_given("loop_margins", f_hz)
    at = response_at(S)
    response = at(f)
    beside = ends(S.rate_hz) if f_hz is None else None
    rows = [_crossings(1 / response[i, i] - 1, f) for i in range(loops)]
    # alpha = 1 / ||S_ii - 1/2|| (Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277)
    disk = [1.0 / _peak_off_half(at, i, f, response[i, i], beside) for i in range(loops)]
    up, down, phase, delay = (np.array(column) for column in zip(*rows, strict=True))
    return Margins(up, down, phase, delay, np.array(disk))


def _peak_off_half(
    at: Callable[[FloatArray], ComplexArray], i: int, f: FloatArray, S: ComplexArray, beside: FloatArray | None
) -> float:
    """Return the largest |S_ii - 1/2|, between the lines of the grid too."""
    return refined(lambda lines: np.abs(at(lines)[i, i] - 0.5), f, np.abs(S - 0.5), beside)[0]


def _crossings(L: ComplexArray, f: FloatArray) -> tuple[float, float, float, float]:
    """Return gain-up dB, gain-down dB, phase deg and delay s of one loop from its Nyquist curve."""
    factors = _real_axis_factors(L)
    up, down = factors[factors > 1], factors[factors < 1]
    log_size = np.log(np.maximum(np.abs(L), 1e-300))
    at = np.flatnonzero(np.sign(log_size[1:]) != np.sign(log_size[:-1]))
    t = log_size[at] / (log_size[at] - log_size[at + 1])
    angle = np.angle(L[at] + t * (L[at + 1] - L[at]))
    f_cross = f[at] + t * (f[at + 1] - f[at])
    phase = np.abs(np.pi - np.abs(angle))
    lag = np.mod(angle - np.pi, 2 * np.pi)  # lag that turns L into -1
    with np.errstate(divide="ignore"):
        delay = lag / (2 * np.pi * f_cross)
    return (
        20 * float(np.log10(up.min())) if up.size else np.inf,
        -20 * float(np.log10(down.max())) if down.size else np.inf,
        float(np.degrees(phase.min())) if phase.size else np.inf,
        float(delay.min()) if delay.size else np.inf,
    )


def _real_axis_factors(L: ComplexArray) -> FloatArray:
    """Return the gains k at which 1 + k L vanishes, from crossings of the negative real axis and both ends."""
    at = np.flatnonzero(np.sign(L.imag[1:]) != np.sign(L.imag[:-1]))
    t = L.imag[at] / (L.imag[at] - L.imag[at + 1])
    ends = [v.real for v in L[[0, -1]] if abs(v.imag) < 1e-6 * abs(v)]
    real = np.concatenate([L.real[at] + t * (L.real[at + 1] - L.real[at]), ends])
    return -1 / real[real < 0]


def grid_given(who: str, f_hz: ArrayLike) -> FloatArray:
    """Return a caller's frequencies in Hz, rising, one at least."""
    f = np.sort(frequency_array(who, f_hz))
    if not f.size:
        raise InputError(f"{who}: 'f_hz' must hold at least one frequency.")
    return f


def default_grid(S: StateSpace) -> FloatArray:
    """Return frequencies in Hz up to Nyquist, log-spaced, with those of the poles."""
    poles = S.poles()
    if S.rate_hz is None:
        size = np.abs(poles) / (2 * np.pi)
        top = 10 * float(size.max(initial=1e-3))
    else:
        size = np.abs(np.angle(poles)) * S.rate_hz / (2 * np.pi)
        top = S.rate_hz / 2
    return np.unique(np.concatenate([np.geomspace(top * 10**-DECADES, top, POINTS), size[size < top]]))
