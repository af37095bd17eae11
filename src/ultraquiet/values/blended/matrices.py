"""From where sensors and actuators stand to the matrices that blend them: least squares, checked for rank."""

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError

RIGID_BODY = ("x", "y", "z", "rx", "ry", "rz")
# Singular values of a matrix with evened rows and columns; less of the largest one is rounding of the entries.
RANK_SHARE = 1e-9
# Sweeps that even rows and columns, and the change after which they are even.
EVENING_SWEEPS, EVEN = 1000, 1e-14
# cos(90 degrees) is 6e-17: of the largest entry of its kind, less is zero.
ROUNDING = 1e-12


def rigid_body(positions_m: ArrayLike, directions: ArrayLike, centre_m: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return what each sensor sees of a rigid body's motion: row i is [d_i', ((p_i - c) x d_i)'].

    Args:
        positions_m: `(n, 3)`, where the sensors (or actuators) stand, in metres.
        directions: `(n, 3)`, along which they measure (or push); only the direction counts, not the length.
        centre_m: `(3,)`, the point whose motion is meant, in metres.

    Returns:
        `(n, 6)`, columns as in `RIGID_BODY`: x, y, z in the sensors' unit, rotations in that unit per metre. Of
        actuators it is the transpose of what forces do to the body: w = H' u, forces and moments about the centre.

    Raises:
        InputError: shapes that do not fit, a direction of length zero.

    >>> rigid_body([[0.0, 2.0, 0.0]], [[0.0, 0.0, 1.0]]).tolist()
    [[0.0, 0.0, 1.0, 2.0, 0.0, 0.0]]

    Reference: A. Preumont, Vibration Control of Active Structures, 4th ed. (2018), doi:10.1007/978-3-319-72296-2.
    """
    p, d = (real_array("rigid_body", n, v, 2) for n, v in (("positions_m", positions_m), ("directions", directions)))
    c = real_array("rigid_body", "centre_m", centre_m, 1)
    if p.shape != d.shape or p.shape[1] != 3 or c.shape != (3,):
        raise InputError(
            f"rigid_body: 'positions_m' and 'directions' must both be (n, 3) and 'centre_m' (3,), got {p.shape}, "
            f"{d.shape} and {c.shape}."
        )
    length = np.sqrt(np.sum(d**2, axis=1, keepdims=True))
    if not length.all():
        raise InputError(f"rigid_body: direction {int(np.argmin(length)) + 1} has length zero; say where it points.")
    d = d / length
    lever = np.cross(p - c, d)
    parts = [np.where(np.abs(a) > ROUNDING * np.abs(a).max(), a, 0.0) for a in (d, lever)]
    return np.hstack(parts)


def sensor_matrix(shapes: ArrayLike, noise: ArrayLike | None = None, left_out: Collection[int] = ()) -> FloatArray:
    """Return Ts of q = Ts y, the least-squares modes of readings y = H q: Ts = (H' W H)^-1 H' W.

    Args:
        shapes: H `(sensors, modes)`: what each sensor reads of each mode, `rigid_body` or some of its columns, or
            measured mode shapes.
        noise: standard deviation of each sensor's noise, `(sensors,)`; W is its inverse square. Alike when absent,
            which takes sensors of one unit.
        left_out: sensors (by index) that count for nothing; their columns of Ts are zero.

    Returns:
        `(modes, sensors)`, Ts H = I to rounding.

    Raises:
        InputError: fewer sensors than modes, or modes that the sensors cannot tell apart.

    >>> sensor_matrix([[1.0, 1.0], [1.0, -1.0]]).round(12).tolist()
    [[0.5, 0.5], [0.5, -0.5]]
    """
    return _least_squares("sensor_matrix", "sensor", shapes, noise, left_out)


def actuator_matrix(shapes: ArrayLike, effort: ArrayLike | None = None, left_out: Collection[int] = ()) -> FloatArray:
    """Return Ta of u = Ta v, the commands of least effort that drive the modes alone: Ta = W B' (B W B')^-1.

    Args:
        shapes: H = B' `(actuators, modes)`: what each mode gets of each actuator's command, `rigid_body` or some of
            its columns; modes that are not among them are driven as it falls.
        effort: largest command of each actuator, `(actuators,)`; W is its square. Alike when absent.
        left_out: actuators (by index) that get no command; their rows of Ta are zero.

    Returns:
        `(actuators, modes)`, H' Ta = I to rounding.

    Raises:
        InputError: fewer actuators than modes, or modes that the actuators cannot drive apart.

    >>> actuator_matrix([[1.0, 1.0], [1.0, -1.0]]).round(12).tolist()
    [[0.5, 0.5], [0.5, -0.5]]
    """
    weight = None if effort is None else 1.0 / _above_zero("actuator_matrix", "effort", effort)
    return _least_squares("actuator_matrix", "actuator", shapes, weight, left_out).T


def rank(matrix: FloatArray) -> int:
    """Return the rank of a matrix once its rows and columns are evened, so that no unit decides it.

    >>> rank(np.array([[1e9, 0.0], [0.0, 1e-9]])), rank(np.array([[1.0, 2.0], [2.0, 4.0]]))
    (2, 1)
    """
    values = np.linalg.svd(_evened(matrix)[0], compute_uv=False)
    return int(np.count_nonzero(values > RANK_SHARE * values[0])) if values.size and values[0] > 0 else 0


def row_sizes(matrix: FloatArray) -> FloatArray:
    """Return the size of each row apart from the units of rows and columns, `(rows,)`; one for a row of zeros.

    >>> sizes = row_sizes(np.array([[1.0, 2.0], [1e9, 1e9]]))
    >>> round(float(sizes[1] / sizes[0]) / 1e9, 3)
    0.707
    """
    return _evened(matrix)[1]


def _evened(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the matrix with rows, and with columns, of one size, and the factors that its rows were divided by."""
    evened, rows = np.array(matrix, dtype=np.float64), np.ones(matrix.shape[0])
    for _ in range(EVENING_SWEEPS):
        column = np.sqrt(np.sum(evened**2, axis=0))
        evened = evened / np.where(column > 0, column, 1.0)
        size = np.sqrt(np.sum(evened**2, axis=1))
        size = np.where(size > 0, size, 1.0)
        evened, rows = evened / size[:, None], rows * size
        if np.ptp(size) < EVEN * size.max():
            break
    return evened, rows


def _least_squares(
    who: str, kind: str, shapes: ArrayLike, spread: ArrayLike | None, left_out: Collection[int]
) -> FloatArray:
    """Return (H' W H)^-1 H' W with columns of zeros for what is left out, W the inverse square of `spread`."""
    H = real_array(who, "shapes", shapes, 2)
    count, modes = H.shape
    size = np.ones(count) if spread is None else _above_zero(who, "noise", spread)
    if size.shape != (count,):
        raise InputError(f"{who}: one number per {kind} is needed, {count} of them, got {size.size}.")
    beyond = [k for k in left_out if not 0 <= k < count]
    if beyond:
        raise InputError(f"{who}: there is no {kind} {beyond[0]} to leave out, they are numbered 0 to {count - 1}.")
    kept = [k for k in range(count) if k not in left_out]
    if rank(H[kept]) < modes:
        raise InputError(
            f"{who}: {len(kept)} {kind}s tell {rank(H[kept])} of {modes} modes apart; ask for fewer modes, or place "
            f"the {kind}s otherwise."
        )
    weighted = H[kept] / size[kept, None]
    column = np.sqrt(np.sum(weighted**2, axis=0))
    Q, R = np.linalg.qr(weighted / column)
    inverse = np.linalg.solve(R, Q.T)
    # A channel without a part in a mode has a zero there, not the rounding of one: units and limits are read from it.
    inverse = np.where(np.abs(inverse) > ROUNDING * np.abs(inverse).max(axis=1, keepdims=True), inverse, 0.0)
    T = np.zeros((modes, count))
    T[:, kept] = inverse / column[:, None] / size[kept]
    return T


def blend(matrix: FloatArray, signals: FloatArray) -> FloatArray:
    """Return T y for signals `(channel, sample)` or one sample `(channel,)`, summed channel by channel.

    A matrix product rounds by the number of samples that it is given; this one is the same in blocks of any length.
    """
    rows = matrix.reshape(matrix.shape + (1,) * (signals.ndim - 1))
    out = np.zeros((matrix.shape[0], *signals.shape[1:]))
    for k in range(matrix.shape[1]):
        out = out + rows[:, k] * signals[k]
    return out


def _above_zero(who: str, name: str, value: ArrayLike) -> FloatArray:
    array = real_array(who, name, value, 1)
    if array.size and array.min() <= 0:
        raise InputError(f"{who}: '{name}' must be above zero for every channel, got {array.min():g}.")
    return array
