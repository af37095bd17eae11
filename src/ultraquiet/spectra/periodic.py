"""Frequency responses from periodic excitation: no leakage, and the noise measured beside them."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.line import counted
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

# A line counts as excited when it stands this far above the median line of the input's spectrum, or above this share
# of the strongest: commands are exact, so the lines that are not meant hold rounding alone.
EXCITED_SHARE = 1e-6
# Periods of an excitation that repeats differ by measurement noise and feedback; those of one that does not, or of a
# wrong length, differ by more than they agree.
REPEATS = 0.5


@takes_values
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
    for k, record in enumerate(records):
        same_rate("periodic_response", "record 1", records[0].rate_hz, f"record {k + 1}", record.rate_hz)
        if len(record.sensors) != len(records[0].sensors):
            raise InputError(
                f"periodic_response: record {k + 1} has {counted(len(record.sensors), 'sensor')}, record 1 has "
                f"{len(records[0].sensors)}; pick the same ones of all (Record.pick)."
            )
    parts = [_one(k, r, len(records), period, settle_periods) for k, r in enumerate(records)]
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
    U, Y = steady_periods("periodic_response", f"record {k + 1}", record, period, settle)
    periods, u = U.shape[1], U[moving[0]]
    level = np.abs(u.mean(axis=0))
    alive = excited_lines(level[np.newaxis])
    safe = np.where(alive, u.mean(axis=0), 1.0)
    return alive, Y.mean(axis=1) / safe, Y.var(axis=1, ddof=1) / periods / np.abs(safe) ** 2


def steady_periods(who: str, name: str, record: Record, period: int, settle: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the spectra of inputs `(nu, periods, nf)` and outputs `(ny, periods, nf)`, period by period.

    Refuses fewer than two periods, and inputs that do not repeat.
    """
    periods = record.samples // period - whole(who, "settle_periods", settle, 0)
    if periods < 2:
        raise InputError(
            f"{who}: {name}, {record.samples} samples, leaves {counted(max(periods, 0), 'whole period')} of {period} "
            f"samples after {settle} to settle; two are needed to tell noise from response, {(2 + settle) * period} "
            "samples in all."
        )
    steady = slice(settle * period, (settle + periods) * period)
    U = np.fft.rfft(record.inputs[:, steady].reshape(-1, periods, period), axis=2)
    Y = np.fft.rfft(record.outputs[:, steady].reshape(-1, periods, period), axis=2)
    for u, wire in zip(U[:, :, 1:], record.actuators, strict=True):
        mean = u.mean(axis=0)
        apart = np.sqrt(np.mean(np.abs(u - mean) ** 2, axis=0).sum())
        if apart > REPEATS * np.linalg.norm(mean):
            raise InputError(
                f"{who}: input '{wire.name}' of {name} does not repeat after {period} samples "
                f"(its periods differ by {100 * apart / max(np.linalg.norm(mean), apart):.0f} %); "
                f"give the period of the excitation, or use local_polynomial for other signals."
            )
    return U, Y


def excited_lines(levels: FloatArray) -> np.ndarray:
    """Return the lines `(nf,)` at which any of the input levels `(nu, nf)` stands out; never 0 Hz."""
    alive = np.any(levels > EXCITED_SHARE * levels[:, 1:].max(axis=1, keepdims=True), axis=0)
    alive[0] = False
    return alive


def evened_inputs(u: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Return inputs `(nf, nu, experiments)` each over its largest size at a line, and these sizes `(nf, nu, 1)`.

    Whether inputs can be told apart says nothing of the units they are in.
    """
    size = np.abs(u).max(axis=2, keepdims=True)
    size = np.where(size > 0, size, 1.0)
    return u / size, size


def inverse_of_inputs(u: ComplexArray) -> ComplexArray:
    """Return the pseudoinverse `(nf, experiments, nu)` of inputs `(nf, nu, experiments)` in whatever units."""
    even, size = evened_inputs(u)
    return np.asarray(np.linalg.pinv(even) / np.swapaxes(size, 1, 2), dtype=np.complex128)
