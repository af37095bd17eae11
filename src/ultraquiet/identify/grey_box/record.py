"""A grey-box model of a record: clipped readings mended, the misfit judged in time."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.shown.line import p_in_words
from ultraquiet._base.threads import single_threaded
from ultraquiet.identify.result import SIGNIFICANCE, Result, worst
from ultraquiet.linalg import portmanteau
from ultraquiet.linalg.prediction import fit_percent, repaired
from ultraquiet.values import Record, StateSpace, Status, StatusWord

REPAIRS = 12
SETTLED = 1e-3
TEST_LAGS = 40
RESIDUAL_LAGS = 200
SHORTEST = 1e-6  # poles nearer to zero are those of the delay


@single_threaded
def fitted_to_record(method: Any, record: Record, fit: Callable[[Record, FloatArray, Any], Any]) -> Result:
    """Fit a record whose readings may be clipped, and say what the model is worth.

    Args:
        method: settings, with `name` and `repair`.
        record: of the channels wanted.
        fit: from a record, outputs in place of its own and an earlier fit to begin with (or None) to a value with
            `model`, `status`, `covariance` and `iterations`.
    """
    low, high = (np.array([[getattr(c, k)] for c in record.sensors]) for k in ("low", "high"))
    clipped = (record.outputs <= low) | (record.outputs >= high)
    y = record.outputs
    fitted = fit(record, y, None)
    simulated = played(fitted.model, record, y, clipped)
    for _ in range(REPAIRS if method.repair and clipped.any() else 0):
        mended = np.array([repaired(*row) for row in zip(record.outputs, simulated, low, high, strict=True)])
        moved = np.linalg.norm(mended - y) / np.linalg.norm(mended)
        y = mended
        fitted = fit(record, y, fitted)
        simulated = played(fitted.model, record, y, clipped)
        if moved < SETTLED:
            break
    return _result(method, record, fitted, np.clip(simulated, low, high), int(clipped.sum()))


def played(model: StateSpace, record: Record, y: FloatArray, clipped: np.ndarray) -> FloatArray:
    """Return the model's outputs `(ny, n)`, its past before the first sample and a constant fitted where not clipped.

    The response to the inputs as if they were periodic, and free decays of all poles for what is wrong with that.
    """
    n = record.samples
    f = np.fft.rfftfreq(n, 1.0 / record.rate_hz)
    G = model.frequency_response(f)
    forced = np.fft.irfft(np.einsum("ijf,jf->if", G, np.fft.rfft(record.inputs, axis=1)), n, axis=1)
    every = model.poles()
    lasting = np.abs(every) > SHORTEST
    poles = np.asarray(np.unique(np.round(every[(every.imag >= 0) & lasting], 12)), dtype=np.complex128)
    decays = np.asarray(np.exp(np.log(poles)[:, None] * np.arange(n)), dtype=np.complex128)
    late = np.eye(int(np.count_nonzero(~lasting)), n)
    columns = np.vstack([decays.real, decays.imag[poles.imag > 0], late, np.ones((1, n))]).T
    columns /= np.linalg.norm(columns, axis=0)
    out = np.empty_like(y)
    for i, row in enumerate(y):
        unclipped = ~clipped[i]
        x = np.linalg.lstsq(columns[unclipped], (row - forced[i])[unclipped], rcond=1e-10)[0]
        out[i] = forced[i] + columns @ x
    return out


def _result(method: Any, record: Record, fitted: Any, simulated: FloatArray, clipped: int) -> Result:
    error = record.outputs - simulated
    lags, memory = (min(k, record.samples // 10) for k in (TEST_LAGS, RESIDUAL_LAGS))
    # What lies outside the band was not fitted: where it is quieter than the band it would show the fit's own spread.
    inputs, inside = (_within(v, record.rate_hz, method.band_hz) for v in (record.inputs, error))
    free = np.array([_free_of_inputs(e, inputs, lags, memory) for e in inside])
    statuses = [_verdict(fitted.status, p) for p in free]
    provenance = Provenance(method.name, asdict(method), parents=(record.hash,), versions=versions())
    return Result(
        model=fitted.model,
        status=worst(statuses),
        fit_percent=np.array([fit_percent(y, m) for y, m in zip(record.outputs, simulated, strict=True)]),
        loss=np.mean(error**2, axis=1),
        covariance=np.broadcast_to(fitted.covariance, (len(error), *fitted.covariance.shape)),
        whiteness_p=np.array([portmanteau.ljung_box(e, lags).p_value for e in error]),
        correlation_p=free,
        iterations=np.full(len(error), fitted.iterations),
        statuses=tuple(statuses),
        provenance=provenance,
        details={"fit": fitted, "repaired": clipped if method.repair else 0},
        no_band="no band: the covariance is of physical parameters, whose structure no record is sure to obey.",
    )


def _within(signals: FloatArray, rate_hz: float, band_hz: tuple[float, float]) -> FloatArray:
    """Return signals with what lies outside the band taken away."""
    n = signals.shape[1]
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    spectrum = np.fft.rfft(signals, axis=1)
    spectrum[:, (f < band_hz[0]) | (f > band_hz[1])] = 0.0
    return np.fft.irfft(spectrum, n, axis=1)


def _free_of_inputs(e: FloatArray, u: FloatArray, lags: int, memory: int) -> float:
    moving = [x for x in u if np.ptp(x) > 0.0]
    return portmanteau.sidak(portmanteau.cross_correlation(e, x, lags, memory).p_value for x in moving)


def _verdict(status: Status, p: float) -> Status:
    if status.ok and p < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The simulated error still holds something of the inputs ({p_in_words(p)}): the structure leaves part of "
            f"the record unexplained. {status.sentence}",
        )
    return status
