"""Comparison of models with records and of models with each other, as sections 3.5 and 3.6 of the paper."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frozen, real_array, some_lines
from ultraquiet._base.errors import InputError
from ultraquiet.linalg.prediction import fit_percent, repaired
from ultraquiet.validate.predict import Model, predicted, simulated
from ultraquiet.values import FrequencyResponse, InnovationForm, PolynomialMatrix, PolynomialModel, Record
from ultraquiet.values.handed_over.kinds import answering, takes_values

REPAIRS = 3  # rounds in which clipped samples take the model's output before its state and constant are fitted


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model's outputs beside the recorded ones.

    Attributes:
        outputs: `(ny, n)` what the model says.
        fit_percent: `(ny,)` 100 (1 - ||y - y_model|| / ||y - mean y||): 100 is perfect, 0 the mean, negative worse.
        clipped: per output, how many recorded samples stand at the sensor's limits.
    """

    outputs: FloatArray
    fit_percent: FloatArray
    clipped: tuple[int, ...]


@takes_values
def compare(
    model: Model,
    record: Record,
    *,
    steps: int | None = None,
    initial: str = "estimate",
    offset: bool = True,
    clip: bool = True,
) -> Comparison:
    """Compare a model with a record, simulated from the inputs alone or predicted `steps` samples ahead.

    A sensor with limits clips what it reads (the paper's 60 Hz sine of figure 10 stands at +-10 V for part of each
    period). The model's output is cut at the same limits before it is judged, so that the unclipped part decides.

    Args:
        model: `(ny, nu)` channels at the record's rate.
        record: another one than the model was made from, to be worth something.
        steps: prediction horizon in samples; None simulates.
        initial: "estimate" fits the state before the first sample, "rest" takes it as zero (simulation only).
        offset: whether a constant is fitted to each output (simulation only).
        clip: whether the sensors' limits cut the model's outputs too.

    Raises:
        InputError: other channels or another rate than the model's.

    >>> import numpy as np, ultraquiet as uq
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    >>> u = np.sin(np.arange(200.0))
    >>> y = np.clip(lag.state_space().simulate(u[None]), -0.3, 0.3)
    >>> record = uq.Record(u, y, 1.0, sensors=[uq.Channel("g", "V", -0.3, 0.3)])
    >>> round(float(compare(lag, record, initial="rest", offset=False).fit_percent[0]), 6)
    100.0

    Reference: section 3.5 of the paper.
    """
    if steps is None:
        out = _simulated_clipped(model, record, initial, offset) if clip else simulated(model, record, initial, offset)
    elif isinstance(model, PolynomialMatrix | PolynomialModel | InnovationForm):
        out = predicted(model, record, steps)
    else:
        raise InputError("compare: a plain StateSpace carries no noise model; simulate it (steps=None).")
    if clip:
        out = _cut(out, record)
    fits = [fit_percent(y, x) for y, x in zip(record.outputs, out, strict=True)]
    return Comparison(frozen(out), np.array(fits), record.clipped())


def _simulated_clipped(model: Model, record: Record, initial: str, offset: bool) -> FloatArray:
    # Samples at the limits would pull the fitted state and constant inwards: the model's own output replaces them.
    out = simulated(model, record, initial, offset)
    for _ in range(REPAIRS if any(record.clipped()) else 0):
        mended = [repaired(y, x, c.low, c.high) for y, x, c in zip(record.outputs, out, record.sensors, strict=True)]
        out = simulated(model, Record(record.inputs, mended, record.rate_hz), initial, offset)
    return out


def _cut(out: FloatArray, record: Record) -> FloatArray:
    low = np.array([[c.low] for c in record.sensors])
    high = np.array([[c.high] for c in record.sensors])
    return np.where(np.isfinite(out), np.clip(out, low, high), out)


@dataclass(frozen=True, eq=False)
class BodeAgreement:
    """Difference of two responses over a band, second minus first.

    Attributes:
        f_hz: `(nf,)` where they were compared.
        gain_db, phase_deg: `(ny, nu, nf)` differences; the phase wrapped into +-180 degrees.
        worst_gain_db, worst_phase_deg: `(ny, nu)` largest absolute differences.
    """

    f_hz: FloatArray
    gain_db: FloatArray
    phase_deg: FloatArray
    worst_gain_db: FloatArray
    worst_phase_deg: FloatArray


POINTS_PER_BAND = 200
SAME_LINE = 1e-9  # two frequencies nearer to each other than this share are one line


def bode_agreement(
    first: Any, second: Any, band_hz: Sequence[float] | None = None, f_hz: ArrayLike | None = None
) -> BodeAgreement:
    """Compare two responses in dB and degrees over a band: models, systems or measured responses.

    Args:
        first: anything with `frequency_response(f_hz)`, or a `FrequencyResponse`.
        second: likewise. Two measured ones must share their lines; beside one measured response the lines are its own,
            inside the band.
        band_hz: lowest and highest frequency; all lines of a measured response when absent.
        f_hz: lines of your own instead, in Hz.

    Raises:
        InputError: an empty band, none beside two models, unequal shapes, lines that two measured responses do not
            share.

    >>> import ultraquiet as uq
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1000.0)
    >>> twice = uq.PolynomialModel(b=[[0.0, 1.0]], f=[[1.0, -0.5]], rate_hz=1000.0)
    >>> bode_agreement(lag, twice, (5.0, 200.0)).worst_gain_db.round(3)
    array([[6.021]])

    Reference: section 3.6 and figure 11 of the paper.
    """
    who = "bode_agreement"
    first, second = answering(who, "first", first), answering(who, "second", second)
    f = _lines(who, (first, second), band_hz) if f_hz is None else some_lines(who, f_hz)
    g, h = (_response(who, x, f) for x in (first, second))
    if g.shape != h.shape:
        raise InputError(f"{who}: the responses have shapes {g.shape} and {h.shape}.")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = h / g
        gain_db = 20.0 * np.log10(np.abs(ratio))
    phase_deg = np.degrees(np.angle(ratio))
    return BodeAgreement(f, gain_db, phase_deg, np.max(np.abs(gain_db), axis=2), np.max(np.abs(phase_deg), axis=2))


def _lines(who: str, compared: tuple[Any, Any], band_hz: Sequence[float] | None) -> FloatArray:
    """Return the lines of measured responses inside the band, or points of it for two models."""
    measured = [x for x in compared if isinstance(x, FrequencyResponse)]
    if band_hz is None and not measured:
        raise InputError(f"{who}: two models have no lines of their own; give 'band_hz' or 'f_hz' to compare them on.")
    band = np.array([0.0, np.inf]) if band_hz is None else real_array(who, "band_hz", np.asarray(band_hz), 1)
    if band.size != 2:
        raise InputError(f"{who}: 'band_hz' must be the lowest and the highest frequency, got {band.size} numbers.")
    low, high = band.tolist()
    if band_hz is not None and not 0 < low < high:
        raise InputError(f"{who}: the band must run upwards from above zero, got {low:g} to {high:g} Hz.")
    if not measured:
        return np.geomspace(low, high, POINTS_PER_BAND)
    own = measured[-1].f_hz
    return own[(own >= low) & (own <= high)]


def _response(who: str, system: Any, f: FloatArray) -> Any:
    if not isinstance(system, FrequencyResponse):
        return system.frequency_response(f)
    at = nearest_lines(system.f_hz, f)
    if f.size == 0 or at is None:
        raise InputError(f"{who}: a measured response has no line at some of the {f.size} frequencies compared.")
    return system.values[:, :, at]


def nearest_lines(lines_hz: FloatArray, f_hz: FloatArray) -> np.ndarray | None:
    """Return where the lines of a measured response, in any order, hold frequencies; None where one is missing.

    Two quotients of one frequency differ by rounding, upwards or downwards.
    """
    if not lines_hz.size:
        return None
    order = np.argsort(lines_hz, kind="stable")
    rising = lines_hz[order]
    above = np.minimum(np.searchsorted(rising, f_hz), rising.size - 1)
    below = np.maximum(above - 1, 0)
    at = order[np.where(f_hz - rising[below] < rising[above] - f_hz, below, above)]
    return at if np.allclose(lines_hz[at], f_hz, rtol=SAME_LINE, atol=0.0) else None
