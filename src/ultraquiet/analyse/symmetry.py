"""How symmetric a response is: reciprocity, and the threefold symmetry of a hexapod."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError


def reciprocity_error(values: ComplexArray) -> FloatArray:
    """Return ||G - G'|| / ||G|| over frequency, Frobenius norms.

    Args:
        values: square response `(n, n, nf)`.

    Returns:
        `(nf,)`, zero where every pair of actuator and sensor may be exchanged, as for a structure on a rigid floor with
        collocated pairs.

    >>> float(reciprocity_error(np.array([[[1.0 + 0j], [0.5]], [[0.5], [1.0]]]))[0])
    0.0
    """
    _square("reciprocity_error", values)
    return _relative(values - np.swapaxes(values, 0, 1), values)


def threefold_error(values: ComplexArray) -> FloatArray:
    """Return ||G - R G R'|| / ||G|| over frequency, R moving every strut to the one 120 degrees further.

    Args:
        values: response `(6, 6, nf)`, struts numbered round the hexapod, so that 1, 3 and 5 change places.

    Returns:
        `(nf,)`, zero for a hexapod whose three pairs of struts are alike: its 36 functions are then 12, with mirror
        symmetry (the struts of each pair change places) 6, and with reciprocity besides 5.

    >>> float(threefold_error(np.ones((6, 6, 1), dtype=complex))[0])
    0.0
    """
    _square("threefold_error", values)
    if values.shape[0] != 6:
        raise InputError(f"threefold_error: six struts are needed, got {values.shape[0]}.")
    turned = np.roll(np.roll(values, 2, axis=0), 2, axis=1)
    return _relative(values - turned, values)


def _relative(difference: ComplexArray, values: ComplexArray) -> FloatArray:
    size = np.sqrt(np.sum(np.abs(values) ** 2, axis=(0, 1)))
    return np.sqrt(np.sum(np.abs(difference) ** 2, axis=(0, 1))) / np.where(size > 0, size, 1.0)


def _square(who: str, values: ComplexArray) -> None:
    if values.ndim != 3 or values.shape[0] != values.shape[1]:
        raise InputError(f"{who}: the response must be (n, n, nf), got {values.shape}.")
