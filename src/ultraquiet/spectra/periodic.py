"""Frequency responses from periodic excitation: no leakage, and the noise measured beside them."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.values import FrequencyResponse, Record

# A line counts as excited when it stands this far above the median line of the input's spectrum, or above this share
# of the strongest: commands are exact, so the lines that are not meant hold rounding alone.
EXCITED_SHARE = 1e-6


def periodic_response(records: Sequence[Record], period_samples: int, settle_periods: int = 1) -> FrequencyResponse:
    """Return G(f) = Y / U at the excited lines, averaged over the periods, with the variance of that average.

    Args:
        records: record k excites actuator k alone, with a signal of period `period_samples`.
        period_samples: length of one period in samples.
        settle_periods: periods left out at the start, while transients die.

    Returns:
        The response `(ny, nu, nf)` at the lines that every record excites, its `variance` from the scatter of the
        periods (noise; distortion that repeats is not in it).

    Raises:
        InputError: fewer than two whole periods remain, a record excites another actuator than its own, no common line.

    >>> u = np.cos(2 * np.pi * np.arange(300) / 10)
    >>> g = periodic_response([Record([u], [np.roll(u, 1)], rate_hz=100.0)], period_samples=10)
    >>> g.f_hz.tolist(), complex(g.values[0, 0, 0].round(3))
    ([10.0], (0.809-0.588j))

    Reference: Pintelon and Schoukens 2012, chapter 2, doi:10.1002/9781118287422.
    """
    period = whole("periodic_response", "period_samples", period_samples, 2)
    if not records:
        raise InputError("periodic_response: no records were given; one per actuator is needed.")
    parts = [_one(k, r, len(records), period, settle_periods) for k, r in enumerate(records)]
    for k, record in enumerate(records):
        same_rate("periodic_response", "record 1", records[0].rate_hz, f"record {k + 1}", record.rate_hz)
    lines = np.flatnonzero(np.logical_and.reduce([alive for alive, _, _ in parts]))
    if lines.size == 0:
        raise InputError("periodic_response: the records share no excited line; excite all actuators alike.")
    count = (records[0].samples // period) - settle_periods
    return FrequencyResponse(
        lines * records[0].rate_hz / period,
        np.stack([g[:, lines] for _, g, _ in parts], axis=1),
        estimator=f"{count} periods of {period} samples, {settle_periods} left out",
        actuators=[r.actuators[min(k, len(r.actuators) - 1)] for k, r in enumerate(records)],
        sensors=records[0].sensors,
        provenance=Provenance("spectra.periodic", {"period_samples": period}, parents=tuple(r.hash for r in records)),
        variance=np.stack([v[:, lines] for _, _, v in parts], axis=1),
    )


def _one(k: int, record: Record, count: int, period: int, settle: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which lines are excited `(nf,)`, the gains and their variances `(ny, nf)` of one record."""
    moving = [j for j, u in enumerate(record.inputs) if np.ptp(u) > 0]
    if len(moving) != 1 or (len(record.actuators) == count and moving[0] != k):
        raise InputError(f"periodic_response: record {k + 1} must excite actuator {k + 1} alone.")
    periods = record.samples // period - whole("periodic_response", "settle_periods", settle, 0)
    if periods < 2:
        raise InputError(
            f"periodic_response: record {k + 1} leaves {periods} whole periods of {period} samples; "
            f"two are needed to tell noise from response."
        )
    kept = slice(settle * period, (settle + periods) * period)
    U = np.fft.rfft(record.inputs[moving[0], kept].reshape(periods, period), axis=1)
    Y = np.fft.rfft(record.outputs[:, kept].reshape(-1, periods, period), axis=2)
    level = np.abs(U.mean(axis=0))
    alive = level > EXCITED_SHARE * level[1:].max()
    alive[0] = False
    safe = np.where(alive, U.mean(axis=0), 1.0)
    return alive, Y.mean(axis=1) / safe, Y.var(axis=1, ddof=1) / periods / np.abs(safe) ** 2
