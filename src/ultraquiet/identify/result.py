"""What every identification returns, and the checks all methods share."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.values import PolynomialMatrix, Record, StateSpace, Status

# A verdict errs once in a thousand good models.
SIGNIFICANCE = 1e-3
# Fewer samples a parameter than this leave standard errors of a third and more of the estimate's size.
SAMPLES_PER_PARAMETER = 10


@dataclass(frozen=True, eq=False)
class Result:
    """An identified model and what it is worth.

    Attributes:
        model: `PolynomialMatrix` of one MISO model per output, or a `StateSpace` from a subspace method.
        status: `ok`, `not converged` or `not white`, with a sentence; the worst of the outputs.
        fit_percent: `(ny,)` 100 (1 - ||y - y_sim|| / ||y - mean y||) of the simulated output on the record itself, its
            past before the first sample and a constant fitted.
        loss: `(ny,)` mean squared one-step residual, squared output units.
        covariance: `(ny, p, p)` of the coefficients in the order a, b_1, f_1, b_2, f_2, ..., c, d (without the ones).
        whiteness_p, correlation_p: `(ny,)` p-values that the residual is white, and free of the inputs.
        iterations: `(ny,)` accepted steps of the search.
        statuses: one verdict an output.
        details: numbers that belong to one method alone.
    """

    model: PolynomialMatrix | StateSpace
    status: Status
    fit_percent: FloatArray
    loss: FloatArray
    covariance: FloatArray
    whiteness_p: FloatArray
    correlation_p: FloatArray
    iterations: np.ndarray[Any, np.dtype[np.int64]]
    statuses: tuple[Status, ...]
    provenance: Provenance
    details: Mapping[str, Any]

    def state_space(self) -> StateSpace:
        """Return the path from inputs to outputs as a well-conditioned system."""
        return self.model if isinstance(self.model, StateSpace) else self.model.state_space()


@runtime_checkable
class Identification(Protocol):
    """A settings object with the verb `identify`."""

    def identify(self, record: Record) -> Result:
        """Return the model of the record."""
        ...


def usable(who: str, record: Record, parameters: int, memory: int) -> None:
    """Refuse a record that cannot carry a model.

    Too short, an input that never moves or that follows the others, a sensor that never moves, that stands at an
    undeclared limit most of the time, that runs away or drifts along a straight line, or whose power is one
    single reading.
    """
    needed = SAMPLES_PER_PARAMETER * parameters + memory
    if record.samples < needed:
        raise InputError(
            f"{who}: the record has {record.samples} samples, but {parameters} parameters a channel need at least "
            f"{needed}; record longer or lower the order."
        )
    for kind, signals, wires in (
        ("input", record.inputs, record.actuators),
        ("output", record.outputs, record.sensors),
    ):
        for signal, wire in zip(signals, wires, strict=True):
            if np.ptp(signal) == 0.0:
                raise InputError(
                    f"{who}: {kind} '{wire.name}' is constant at {signal[0]:g} {wire.unit}, which no model can be "
                    f"drawn from; excite it, or leave the channel out with record.pick."
                )
    _told_apart(who, record)
    _truthful(who, record)


# Of an input's power, what the other inputs leave unexplained at the same sample; less is rounding.
OWN_SHARE = 1e-10
# Readings at their largest or least value, beyond which most of the record is the limit and not the plant. Declared
# limits are repaired; a two-valued output of a noise-free gain is refused as well, it carries a sign and no more.
AT_EXTREMES = 0.2
ONE_READING = 0.5  # share of an output's power in one sample
ONE_LINE = 0.999  # share of an output's power in one straight line: what the plant answers is lost in it


# An output with this share of its power in the last tenth, of inputs that are not louder there, has run away.
RUNAWAY, NO_LOUDER = 0.9, 0.5


def _told_apart(who: str, record: Record) -> None:
    centred = record.inputs - record.inputs.mean(axis=1, keepdims=True)
    correlation = np.corrcoef(centred) if len(centred) > 1 else np.eye(1)
    values, vectors = np.linalg.eigh(correlation)
    if values[0] < OWN_SHARE:
        alike = np.flatnonzero(np.abs(vectors[:, 0]) > 1e-3 * np.abs(vectors[:, 0]).max())
        names = ", ".join(f"'{record.actuators[k].name}'" for k in alike)
        raise InputError(
            f"{who}: the inputs {names} follow from each other, so their effects cannot be told apart; excite them by "
            f"independent signals, or leave one out with record.pick."
        )


def _truthful(who: str, record: Record) -> None:
    for y, wire in zip(record.outputs, record.sensors, strict=True):
        held = np.count_nonzero((y == y.max()) | (y == y.min())) / y.size
        if held > AT_EXTREMES and not np.any((y <= wire.low) | (y >= wire.high)):
            raise InputError(
                f"{who}: {held:.0%} of the readings of output '{wire.name}' stand at its largest or least value, "
                f"{y.max():g} or {y.min():g} {wire.unit}; lower the excitation, or declare the sensor's limits."
            )
        power = (y - np.median(y)) ** 2
        if power.max() > ONE_READING * power.sum():
            raise InputError(
                f"{who}: one reading of output '{wire.name}', sample {int(power.argmax())}, holds "
                f"{power.max() / power.sum():.0%} of its power; cut it out (record.part), or mend the wiring."
            )
        if _late(y) > RUNAWAY and max(_late(u) for u in record.inputs) < NO_LOUDER:
            raise InputError(
                f"{who}: the last tenth of the record holds {_late(y):.0%} of the power of output '{wire.name}', which "
                f"its inputs do not explain: the plant is unstable or the sensor runs away; stabilise it first."
            )
        line = abs(float(np.corrcoef(y, np.arange(y.size))[0, 1])) ** 2
        if line > ONE_LINE:
            raise InputError(
                f"{who}: {line:.3%} of the power of output '{wire.name}' is a straight line; wait until the drift has "
                f"settled, or take it out first."
            )


def _late(x: FloatArray) -> float:
    power = (x - np.median(x)) ** 2
    return float(power[-(power.size // 10 + 1) :].sum() / max(power.sum(), np.finfo(float).tiny))


# A tone fills six bins of a Blackman-windowed spectrum and carries two parameters; this share of the strongest bin
# stands above the window's own side lobes.
BINS_PER_PARAMETER = 3
LINE_SHARE = 1e-5


def exciting(who: str, record: Record, parameters: int) -> None:
    """Refuse an input of so few spectral lines that other models fit it as well: a steady tone fixes two parameters."""
    for u, wire in zip(record.inputs, record.actuators, strict=True):
        power = np.abs(np.fft.rfft((u - u.mean()) * np.blackman(u.size))) ** 2
        carried = int(np.count_nonzero(power > LINE_SHARE * power.max())) // BINS_PER_PARAMETER
        if carried < parameters:
            raise InputError(
                f"{who}: input '{wire.name}' holds spectral lines for about {carried} parameters, the path from it has "
                f"{parameters}; excite a band (noise, chirp, many tones) or lower the order."
            )


SEVERITY = ("ok", "not white", "poor fit", "not converged")


def worst(statuses: list[Status]) -> Status:
    """Return the most severe of several verdicts, with how many share it."""
    chosen = max(statuses, key=lambda s: SEVERITY.index(s.word))
    share = sum(s.word == chosen.word for s in statuses)
    if len(statuses) == 1 or chosen.ok:
        return chosen
    return Status(chosen.word, f"{share} of {len(statuses)} channels; the first: {chosen.sentence}")
