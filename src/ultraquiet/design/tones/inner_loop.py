"""What the laws for tones are put round: the plant by itself, or the loop that another controller has closed."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, numbers
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup
from ultraquiet.analyse.margins import bounded_response
from ultraquiet.values.interconnect import feedback, gain, parallel
from ultraquiet.values.state_space import StateSpace

Around = StateSpace | str | None
FAINTEST = 1e-12  # of the largest gain over a coarse grid: below, a plant has no gain
COARSE = 64  # points of that grid


@dataclass(frozen=True)
class Inner:
    """`first` K0, zero when there is none, and `seen` (I - G K0)^-1 G, from what is added to its commands to y.

    `plant` is G itself.
    """

    first: StateSpace
    seen: StateSpace
    plant: StateSpace

    def joined(self, added: StateSpace) -> StateSpace:
        """Return K0 + K."""
        return parallel(self.first, added) if self.first.states or np.any(self.first.D) else added


def inner_loop(who: str, plant: StateSpace, around: Around, stable: bool = True) -> Inner:
    """Return K0 and the plant that a law added to it meets.

    Args:
        who: opens the sentence of a refusal.
        plant: G, discrete.
        around: K0, the name of a registered design method that makes it with its own settings, or None.
        stable: whether a plant without a law around it must be stable.

    Raises:
        InputError: the plant is in continuous time, K0 does not fit, or the loop is unstable.
    """
    if plant.rate_hz is None:
        raise InputError(f"{who}: the plant is in continuous time; discretise it first.")
    if around is None or (isinstance(around, str) and not around):
        first = gain(np.zeros(plant.D.shape[::-1]), plant.rate_hz)
        if stable and not plant.is_stable():
            raise InputError(f"{who}: the plant is unstable by itself; give a stabilising controller as 'around'.")
        return Inner(first, plant, plant)
    first = _made(who, plant, around)
    if first.D.shape != plant.D.shape[::-1]:
        raise InputError(
            f"{who}: the controller 'around' is {first.D.shape[0]} x {first.D.shape[1]} (outputs x inputs), the plant "
            f"offers {plant.D.shape[0]} outputs and {plant.D.shape[1]} inputs."
        )
    seen = feedback(plant, first)
    if not seen.is_stable():
        raise InputError(f"{who}: the loop with the controller 'around' is unstable.")
    return Inner(first, seen, plant)


def _made(who: str, plant: StateSpace, around: StateSpace | str) -> StateSpace:
    if isinstance(around, StateSpace):
        return around
    if not isinstance(around, str):
        raise InputError(f"{who}: 'around' must be a StateSpace or the name of a method, got {type(around).__name__}.")
    result = lookup("design", around)().design(plant)
    if result.controller is None:
        raise InputError(f"{who}: '{around}' made no controller to be put around: {result.status.sentence}")
    return result.controller


def settlings(who: str, settling_s: float | tuple[float, ...] | None, usual_s: float, tones: int) -> FloatArray:
    """Return the time that each tone is given to settle, s, `(tones,)`; one number is that of all, the usual if None.

    Raises:
        InputError: a time that is not above zero, or another number of them than one or one a tone.
    """
    times = numbers(who, "settling_s", usual_s if settling_s is None else settling_s)
    if not times.min(initial=np.inf) > 0:
        raise InputError(f"{who}: 'settling_s' must be above zero, got {times.min():g}.")
    if times.size not in (1, tones):
        raise InputError(f"{who}: 'settling_s' must be one number or {tones}, one a tone, got {times.size}.")
    return np.broadcast_to(times, (tones,))


def checked_tones(who: str, tones_hz: tuple[float, ...], rate_hz: float) -> FloatArray:
    """Return tones in Hz, all different, above zero and below half the rate."""
    tones = numbers(who, "tones_hz", tones_hz)
    if not tones.size:
        raise InputError(
            f"{who}: 'tones_hz' names no tone to work against; give their frequencies in Hz, which a spectrum of the "
            f"readings shows, or take a method for a band."
        )
    for tone in tones:
        if not 0 < tone < rate_hz / 2:
            raise InputError(
                f"{who}: a tone must lie above zero and below half the rate, {rate_hz / 2:g} Hz, got {tone:g} Hz."
            )
    if np.unique(tones).size < tones.size:
        raise InputError(f"{who}: 'tones_hz' names a tone twice: {tones.tolist()}.")
    return tones


@dataclass(frozen=True)
class Inverse:
    """G(f)^-1 in the directions that G has: V S^-1 U', `matrix` `(nu, ny)`, and how many directions were left out."""

    U: ComplexArray
    S: FloatArray
    V: ComplexArray
    left_out: int

    @property
    def matrix(self) -> ComplexArray:
        """The pseudo-inverse."""
        return (self.V / self.S) @ self.U.conj().T


def inverse(who: str, system: StateSpace, tone_hz: float, weakest: float) -> Inverse:
    """Return the pseudo-inverse of G(f); directions weaker than `weakest` times the strongest are left alone.

    Raises:
        InputError: the plant has no gain at the tone.
    """
    assert system.rate_hz is not None
    U, S, Vh = np.linalg.svd(system.frequency_response([tone_hz])[:, :, 0], full_matrices=False)
    # an integrator has no bound on this grid, and any gain is faint beside it
    scale = np.abs(bounded_response(system)(np.linspace(0, system.rate_hz / 2, COARSE))).max()
    if not S[0] > FAINTEST * max(float(scale), np.finfo(float).tiny):
        raise InputError(f"{who}: the plant has no gain at {tone_hz:g} Hz, so no command can cancel that tone.")
    kept = int(np.count_nonzero(weakest * S[0] <= S))
    return Inverse(U[:, :kept], S[:kept], Vh[:kept].conj().T, S.size - kept)
