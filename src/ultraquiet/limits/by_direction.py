"""Limits of a plant of several channels, direction by direction."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, OfFrequency, Shape, real_array, rising_band, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.threads import single_threaded
from ultraquiet.limits._limit import Limit, refused
from ultraquiet.limits.demands import Wishes, checked_control, checked_error, checked_peak
from ultraquiet.limits.directions import AllActuators, along, coupling_db, driven, moved
from ultraquiet.limits.loops import stabilised
from ultraquiet.limits.search import LimitSearch
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

WHO = "by_direction"
ORTHONORMAL = 1e-6


@dataclass(frozen=True, eq=False)
class DirectionLimit:
    """What can be reached in one direction.

    Attributes:
        direction: unit vector v over the plant's outputs.
        limit: of the scalar loop v' G w, w over the inputs v itself or what moves v' G most. `attenuation_db` is
            reached by a controller that serves this direction alone, as far as the direction keeps to itself;
            `bound_db` holds for any controller of all channels.
        coupling_db: how far what leaves the direction lies below what stays, at worst over the band.
    """

    direction: FloatArray
    limit: Limit
    coupling_db: float


@takes_systems
@single_threaded
def by_direction(
    plant: StateSpace,
    band_hz: tuple[float, float],
    peak_db: Shape = 6.0,
    *,
    control_gain: Shape | None = None,
    directions: ArrayLike | None = None,
    basis: int = 60,
    uncertainty: "StateSpace | Shape | None" = None,
) -> tuple[DirectionLimit, ...]:
    """Return the best flat attenuation in each of a few constant directions of a stable plant.

    |v' S v| <= sigma_max(S): what no controller reaches along v, none reaches in its worst direction.

    Args:
        plant: G, stable, of any shape. With more outputs than inputs only as many directions move at once as there are
            inputs; the worst of all stays at 0 dB or above, whatever the controller.
        band_hz: the band to be quiet, Hz.
        peak_db: largest amplification allowed at any frequency in any direction, dB; or a shape `(f_hz, dB)`.
        control_gain: largest singular value of K S; or a shape `(f_hz, gains)`.
        directions: `(ny, k)` orthonormal columns v; when absent, the eigenvectors of the mean of G G* over the band,
            from the one that the plant moves least, as many as it has inputs at most.
        basis: states of Q besides those of the plant's function along v.
        uncertainty: W of a relative error of the plant, G_true = (I + E) G with ||E|| <= |W|: a number for all
            frequencies, a shape `(f_hz, size)`, or a scalar system; a limit is refused where it is one or more in the
            band. Among such plants is E = e v v' with |e| = |W|, whose v' S v is s / (1 + e (1 - s)), s that of the
            plant itself: `bound_db` holds for any controller of all channels that is to keep peak and attenuation on
            every such plant; what is reached is reached for errors along v.

    Returns:
        One `DirectionLimit` a column. The least `limit.bound_db` of them bounds the worst direction of every
        controller, with all its cross terms; the least `limit.attenuation_db` is reached where directions do not mix.

    Raises:
        InputError: the plant is not stable, or the directions are no unit vectors.

    >>> G = StateSpace(0.9 * np.eye(2), np.diag([0.1, 0.02]), np.eye(2), np.zeros((2, 2)), rate_hz=1000.0)
    >>> weak, strong = by_direction(G, (20.0, 100.0), 6.0, control_gain=10.0, basis=30)
    >>> bool(weak.limit.attenuation_db < weak.limit.bound_db < strong.limit.attenuation_db)
    True

    The whole problem, sigma_max(S) <= t over matrices Q, is a semidefinite programme with 36 unknowns a function and a
    24-row cone a demand and frequency for six channels: some 10^5 rows, far beyond a minute. Its bound by directions
    takes seconds and is tight where a constant transform nearly decouples the plant, as it does a hexapod.
    """
    band = rising_band(WHO, band_hz, plant.rate_hz)
    peak = checked_peak(WHO, peak_db, 0.0)
    whole(WHO, "basis", basis, 7)
    if not plant.is_stable():
        raise InputError(f"{WHO}: the plant must be stable; limits of several channels are not known for another.")
    V = moved(plant, band) if directions is None else _unit(directions, plant.D.shape[0])
    error = checked_error(WHO, plant, uncertainty)
    return tuple(one_direction(plant, v, band, peak, control_gain, basis, error) for v in V.T)


def tightened(robust: Limit, plain: Limit) -> Limit:
    """Return a limit of every plant within an error, its bound that of the plant itself where its own is looser.

    A controller for all of them is one for the plant itself.
    """
    if not plain.bound_db < np.nan_to_num(robust.bound_db, nan=np.inf) or robust.status.word is StatusWord.REFUSED:
        return robust
    word = StatusWord.OK if robust.status.word is StatusWord.NOT_CERTIFIED else robust.status.word
    said = f"{robust.status.sentence} The bound of the plant itself is closer: {plain.bound_db:.1f} dB."
    return replace(robust, bound_db=plain.bound_db, status=Status(word, said))


def one_direction(
    plant: StateSpace,
    v: FloatArray,
    band: tuple[float, float],
    peak: float | OfFrequency,
    control_gain: Shape | None,
    basis: int,
    error: OfFrequency | None = None,
) -> DirectionLimit:
    """Return the limit along one unit vector; `peak` is a factor."""
    w = driven(plant, v, band)
    search = LimitSearch(stabilised(along(plant, v, w)), band, basis)
    if not np.any(search.lines.b[search.inside]):
        return DirectionLimit(v, refused(f"{WHO}: the plant does not answer along this direction in the band."), 0.0)
    gain, share = checked_control(WHO, control_gain, search.lines, search.inside)
    wishes = Wishes(band, peak, gain, error, share)
    all_actuators = None if plant.D.shape[1] == 1 else AllActuators(plant, v, search.circle)
    return DirectionLimit(v, search.limit(wishes, bounded_by=all_actuators), coupling_db(plant, v, w, band))


def _unit(directions: ArrayLike, channels: int) -> FloatArray:
    V = real_array(WHO, "directions", directions, 2)
    if V.shape[0] != channels or np.abs(np.sum(V * V, axis=0) - 1).max(initial=0.0) > ORTHONORMAL:
        raise InputError(f"{WHO}: 'directions' must be ({channels}, k) with columns of length one, got {V.shape}.")
    return V
