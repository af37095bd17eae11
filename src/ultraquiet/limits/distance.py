"""How far a design is from what any controller could do at its own price."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, Shape, rising_band, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import loudness, rounded
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.loop_response import closed_system, largest_in_band
from ultraquiet.analyse.margins import even_inputs, peak_sensitivity
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.limits._limit import Limit
from ultraquiet.limits.by_direction import one_direction, tightened
from ultraquiet.limits.demands import checked_error
from ultraquiet.limits.directions import moved
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

WHO = "distance"
NOTHING_DB = 1e-3  # a peak and an attenuation below it are those of a controller that leaves the plant alone


@dataclass(frozen=True, eq=False)
class Distance:
    """A design beside its limit.

    Attributes:
        status: `ok` and what it means; `unstable` when the loop is, `not certified` without a bound.
        attenuation_db: of the design's worst direction over the band; of a plant with more outputs than inputs, the
            worst within the constant directions that it moves most, as many as it has inputs.
        peak_db: its largest |S|.
        control_gain: its largest |K S|.
        limit: the best flat attenuation at this peak and gain along `direction`, the one that the plant moves least.
        left_db: what another controller could add at most at the same price: `limit.bound_db - attenuation_db`.
        direction: unit vector over the outputs.
        robust: the limit where every plant within the uncertainty is to keep that peak and be that quiet; None where
            none was stated, or the plant itself has no bound. A design that goes beyond its bound is that quiet on the
            plant alone.
    """

    status: Status
    attenuation_db: float = float("nan")
    peak_db: float = float("nan")
    control_gain: float = float("nan")
    limit: Limit | None = None
    left_db: float = float("nan")
    direction: FloatArray | None = None
    robust: Limit | None = None


@takes_systems
@single_threaded
def distance(
    plant: StateSpace,
    controller: StateSpace,
    band_hz: tuple[float, float],
    basis: int = 60,
    *,
    uncertainty: "StateSpace | Shape | None" = None,
) -> Distance:
    """Return how much more a band could be attenuated at the design's own peak of S and its own |K S|.

    Args:
        plant: G; stable when it has several channels.
        controller: K, u = K y.
        band_hz: the quiet band, Hz.
        basis: states of the search, see `best_flat_attenuation`.
        uncertainty: relative error of the plant, as of `by_direction`: beside the limit on the plant itself, that of
            every such plant.

    Returns:
        `Distance`. A negative `left_db` would be a contradiction: the bound holds for every linear controller.

    Raises:
        InputError: plant and controller do not fit, the band lies beyond Nyquist.

    A design a few decibels from its limit is finished; one far from it wastes amplification or control.

    >>> G = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> K = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-3.0]], rate_hz=1000.0)
    >>> found = distance(G, K, (1.0, 20.0), basis=30)
    >>> bool(found.left_db > 0), round(found.control_gain, 2)
    (True, 3.56)
    """
    band = rising_band(WHO, band_hz, plant.rate_hz)
    same_rate(WHO, "the plant", plant.rate_hz, "the controller", controller.rate_hz)
    ny, nu = plant.D.shape
    if controller.D.shape != (nu, ny):
        raise InputError(
            f"{WHO}: the plant is {ny} x {nu} (outputs x inputs), so the controller must be {nu} x {ny}; got "
            f"{controller.D.shape[0]} x {controller.D.shape[1]}."
        )
    error = checked_error(WHO, plant, uncertainty)
    control = _control(plant, controller)
    if not control.is_stable():
        return Distance(Status(StatusWord.UNSTABLE, "The loop is unstable; it has no distance to a limit."))
    if max(ny, nu) > 1 and not plant.is_stable():
        return Distance(Status(StatusWord.REFUSED, f"{WHO}: limits of several channels need a stable plant."))
    V = moved(plant, band)
    own, peak_db, gain = (
        _worst_db(plant, controller, band, V),
        peak_sensitivity(plant, controller)[0],
        hinf_norm(control)[0],
    )
    if peak_db < NOTHING_DB and abs(own) < NOTHING_DB:
        said = "The controller does nothing, and nothing is what it costs."
        return Distance(Status(StatusWord.OK, said), own, peak_db, gain, left_db=0.0)
    price = V[:, 0], band, 10 ** (max(peak_db, 0.0) / 20), gain, basis
    limit = one_direction(plant, *price).limit
    robust = None
    if error is not None and np.isfinite(limit.bound_db):
        robust = tightened(one_direction(plant, *price, error).limit, limit)
    status = _verdict(own, peak_db, gain, limit, ny > nu)
    if robust is not None and status.ok:
        status = Status(status.word, f"{status.sentence} {_of_every_plant(robust)}")
    return Distance(status, own, peak_db, gain, limit, limit.bound_db - own, V[:, 0], robust)


def _verdict(own: float, peak_db: float, gain: float, limit: Limit, tall: bool) -> Status:
    if not np.isfinite(limit.bound_db):
        return Status(
            StatusWord.NOT_CERTIFIED, f"No bound was found for a peak of {peak_db:.1f} dB: {limit.status.sentence}"
        )
    quietest = f"no linear controller exceeds {rounded(limit.bound_db)} dB"
    if limit.bound_db < 0 and loudness(limit.bound_db) != loudness(0.0):
        quietest = f"every linear controller leaves it {loudness(limit.bound_db)} or more"
    return Status(
        StatusWord.OK,
        f"The worst direction{' that the plant moves' * tall} gets {loudness(own)}; at the same peak of "
        f"{peak_db:.1f} dB and |K S| of {gain:.3g} {quietest}, a distance of {rounded(limit.bound_db - own)} dB.",
    )


def _of_every_plant(robust: Limit) -> str:
    """Say what none exceeds that is to be that quiet, at that peak, on every plant within the uncertainty."""
    if np.isfinite(robust.bound_db):
        none = f"none exceeds {rounded(robust.bound_db)} dB"
        if robust.bound_db < 0 and loudness(robust.bound_db) != loudness(0.0):
            none = f"every one leaves it {loudness(robust.bound_db)} or more"
        return f"Of those that keep that peak on every plant within the uncertainty {none} on all of them."
    return f"For every plant within the uncertainty no bound was found: {robust.status.sentence}"


def _control(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return K S, from a disturbance at the plant's output to the control."""
    closed, ny = closed_system(plant, controller), plant.D.shape[0]
    return StateSpace(closed.A, closed.B, closed.C[ny:], closed.D[ny:], plant.rate_hz)


def _worst_db(plant: StateSpace, controller: StateSpace, band: tuple[float, float], V: FloatArray) -> float:
    """Return the attenuation of the worst direction over the band, dB, among those in the columns of V."""
    S = sensitivity(*even_inputs(plant, controller))
    size = largest_in_band(S, plant, band, lambda S, _: V.T @ S @ V)[0]
    return -20 * float(np.log10(max(size, np.finfo(float).tiny)))
