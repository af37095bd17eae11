"""Bode's and Poisson's integrals of a loop: what it pays, and what the theory says it owes."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.loop_response import loop_response
from ultraquiet.limits import half_plane
from ultraquiet.limits.quadrature import nodes
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import feedback, sensitivity
from ultraquiet.values.state_space import StateSpace

DB = float(20 / np.log(10))
# ln|S| of a continuous loop falls off with 1 / w: beyond so many times its quickest root little of the integral is left
FAR = 1e6


@dataclass(frozen=True, eq=False)
class Integral:
    """A conserved quantity of a loop.

    Attributes:
        name: what it belongs to: all frequencies, or a zero of the plant.
        measured_db: the weighted mean of 20 log10 |S| over frequency, by quadrature on the loop itself; for Bode's
            integral in continuous time the area in dB Hz.
        owed_db: the same from poles and zeros, in closed form: equal to it, but for a zero of a plant with several
            channels, where it is a lower bound.
    """

    name: str
    measured_db: float
    owed_db: float


@takes_systems
def bode_integral(plant: StateSpace, controller: StateSpace) -> Integral:
    """Return Bode's integral of a stable loop.

    Discrete: mean over 0..Nyquist of ln |det S| = sum ln |p| - ln |det(I - Dg Dk)|. Continuous: integral over w of
    ln |det S| = pi sum Re p + (pi / 2) lim s tr(G K). The p are the unstable poles of plant and controller, u = K y.

    Args:
        plant: G.
        controller: K, its sign inside.

    Returns:
        `Integral`: the mean in dB (all channels together), or in continuous time the area in dB Hz.

    Raises:
        InputError: the loop is unstable, or has a direct path in continuous time, where the area is infinite.

    For stable plant and controller with a sample of delay the mean is zero: each decibel gained over a hertz is lost
    over another. An unstable controller pays for itself as an unstable plant does.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> abs(round(bode_integral(G, K).measured_db, 9)), bode_integral(G, K).owed_db
    (0.0, 0.0)

    Freudenberg and Looze 1985, doi:10.1109/TAC.1985.1104004; discrete: Sung and Hara 1988,
    doi:10.1080/00207178808906305; with several channels: Skogestad and Postlethwaite 2005, section 6.2.
    """
    closed = _closed("bode_integral", plant, controller)
    poles = np.concatenate([plant.poles(), controller.poles()])
    rate_hz = plant.rate_hz
    f, width = nodes(np.concatenate([closed, half_plane.half_plane(poles, rate_hz)]), rate_hz, FAR)
    S = loop_response(plant, controller, f)[0]
    paid = float(np.sum(width * np.log(np.abs(np.linalg.det(S)))))
    direct = plant.D @ controller.D
    if rate_hz is not None:
        outside = np.abs(poles[np.abs(poles) > 1])
        owes = float(np.sum(np.log(outside)) - np.log(abs(np.linalg.det(np.eye(len(direct)) - direct))))
        return Integral("all frequencies", DB * paid / (rate_hz / 2), DB * owes)
    slope = float(np.trace(plant.C @ plant.B @ controller.D + plant.D @ controller.C @ controller.B))
    owes = np.pi * float(poles[poles.real > 0].real.sum()) + np.pi / 2 * slope
    return Integral("all frequencies", DB * (paid + _tail(slope, f)), DB * float(owes) / (2 * np.pi))


@takes_systems
def poisson_integral(plant: StateSpace, controller: StateSpace) -> tuple[Integral, ...]:
    """Return Poisson's integral of a stable loop for every zero of the plant outside the stability region.

    mean of ln |y* S y|, weighted by the harmonic measure seen from the zero, >= ln prod |s + conj(p)| / |s - p|, where
    y* G(s) = 0; equal for one channel, where the p are the unstable poles of plant and controller. With several
    channels zero is what is owed at least.

    Args:
        plant: G, square.
        controller: K, u = K y.

    Returns:
        One `Integral` a zero, by rising frequency; of a conjugate pair one. None for a minimum-phase plant.

    Raises:
        InputError: the loop is unstable.

    Near its zero a plant does not answer, in one direction: there S = 1, and attenuation around it is paid around it.

    >>> G = StateSpace([[0.5]], [[1.0]], [[-1.0]], [[1.0]], rate_hz=100.0)  # (z - 1.5) / (z - 0.5)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.2]], rate_hz=100.0)
    >>> [(abs(round(i.measured_db, 9)), i.owed_db) for i in poisson_integral(G, K)]
    [(0.0, 0.0)]

    Freudenberg and Looze 1985, doi:10.1109/TAC.1985.1104004, theorem 1; Seron, Braslavsky and Goodwin 1997,
    doi:10.1007/978-1-4471-0965-5, theorems 3.3.1 and 4.3.1.
    """
    closed = _closed("poisson_integral", plant, controller)
    rate_hz = plant.rate_hz
    poles = np.concatenate([plant.poles(), controller.poles()])
    unstable = half_plane.unstable(poles, rate_hz)
    zeros = [z for z in half_plane.binding_zeros(plant) if z.direction is not None]
    if not zeros:
        return ()
    dips = half_plane.half_plane(_dips(plant, controller, zeros), rate_hz)
    every = np.concatenate([closed, half_plane.half_plane(poles, rate_hz), [z.s for z in zeros], dips, dips.conj()])
    f, width = nodes(every, rate_hz, FAR)
    S = loop_response(plant, controller, f)[0]
    w = half_plane.speeds(f, rate_hz)
    stretch = 2 * np.pi * (1.0 if rate_hz is None else 1 + (w / (2 * rate_hz)) ** 2)  # dw / df
    integrals = []
    for zero in sorted(zeros, key=lambda z: abs(z.s)):
        y, x, at = np.asarray(zero.direction), zero.s.real, zero.s.imag
        # at negative frequencies S is conjugate, the direction is not
        here, mirrored = (x / (x * x + (w - side) ** 2) for side in (at, -at))
        level = here * np.log(np.abs((S @ y) @ y.conj())) + mirrored * np.log(np.abs((S @ y.conj()) @ y))
        owes = half_plane.owed(zero.s, unstable) if plant.D.shape == (1, 1) else 0.0
        paid = float(np.sum(width * stretch / np.pi * level))
        integrals.append(Integral(zero.name, DB * paid, DB * owes))
    return tuple(integrals)


def _dips(plant: StateSpace, controller: StateSpace, zeros: list[half_plane.BindingZero]) -> ComplexArray:
    """Return the zeros of y* S y for every direction y, near which its logarithm is steep.

    With one channel they are the open loop's poles.
    """
    S = sensitivity(plant, controller)
    dips = []
    for zero in zeros:
        y = np.asarray(zero.direction)
        direct = y.conj() @ S.D @ y
        if direct != 0:
            dips.append(np.linalg.eigvals(S.A - np.outer(S.B @ y, y.conj() @ S.C) / direct))
    return np.concatenate(dips) if dips else np.zeros(0, dtype=np.complex128)


def _tail(slope: float, f_hz: FloatArray) -> float:
    """Return the rest of Bode's integral over f beyond the last node: ln |det S| falls with its second power there."""
    # |1 - c / (j w)|^2 = 1 + c^2 / w^2
    return -(slope**2) / (2 * (2 * np.pi) ** 2 * float(f_hz[-1]))


def _closed(who: str, plant: StateSpace, controller: StateSpace) -> ComplexArray:
    """Return the poles of the closed loop in the half-plane, after the checks."""
    same_rate(who, "the plant", plant.rate_hz, "the controller", controller.rate_hz)
    if plant.D.shape[0] != plant.D.shape[1]:
        raise InputError(f"{who}: the plant must be square, got {plant.D.shape[0]} x {plant.D.shape[1]}.")
    loop = feedback(plant, controller)
    if not loop.is_stable():
        raise InputError(f"{who}: the loop is unstable, its integral says nothing; stabilise it first.")
    if plant.rate_hz is None and np.any(plant.D @ controller.D):
        raise InputError(f"{who}: a direct path in continuous time makes the integral infinite; roll the loop off.")
    return half_plane.half_plane(loop.poles(), plant.rate_hz)
