"""What is done to a record before a model is made of it, besides cutting."""

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of
from ultraquiet.values import Record

KINDS = ("mean", "line")


def detrended(record: Record, kind: str = "mean") -> Record:
    """Return the record without the mean, or the straight line, of every channel.

    x <- x - P x, with P the projection on {1} or on {1, t}.

    Args:
        record: inputs `(nu, n)` and outputs `(ny, n)`.
        kind: `mean` or `line`.

    Raises:
        InputError: another kind.

    >>> detrended(Record([[1.0, 3.0]], [[5.0, 7.0]], rate_hz=1.0)).outputs
    array([[-1.,  1.]])
    """
    one_of("detrended", "kind", kind, KINDS)
    inputs, outputs = (_without(signals, kind == "line") for signals in (record.inputs, record.outputs))
    return Record(inputs, outputs, record.rate_hz, record.actuators, record.sensors, record.provenance)


def _without(signals: FloatArray, line: bool) -> FloatArray:
    centred = signals - signals.mean(axis=1, keepdims=True)
    if not line or signals.shape[1] < 2:
        return centred
    t = np.arange(signals.shape[1]) - (signals.shape[1] - 1) / 2
    # sums, not a product of matrices: the same bits whatever multiplies them
    slopes = (centred * t).sum(axis=1, keepdims=True) / (t * t).sum()
    return centred - slopes * t
