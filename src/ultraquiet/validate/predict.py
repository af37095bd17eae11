"""What a model says of a record: simulated outputs, predictions k steps ahead, innovations."""

import numpy as np

from ultraquiet._base.constraints import FloatArray, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import innovation, prediction
from ultraquiet.values import InnovationForm, PolynomialMatrix, PolynomialModel, Record, StateSpace
from ultraquiet.values.channel import same_unit
from ultraquiet.values.handed_over.kinds import takes_values
from ultraquiet.values.joined.wires import is_numbered, moved

Model = PolynomialMatrix | PolynomialModel | StateSpace
Noisy = PolynomialMatrix | PolynomialModel | InnovationForm  # models that say what their outputs carry besides


@takes_values
def simulated(model: Model, record: Record, initial: str = "estimate", offset: bool = True) -> FloatArray:
    """Return the outputs `(ny, n)` that the model gives to the record's inputs alone.

    Args:
        model: `(ny, nu)` channels at the record's rate.
        record: its inputs drive the model; its outputs only fit what follows.
        initial: "estimate" fits the state before the first sample to the outputs, "rest" takes it as zero.
        offset: whether a constant is fitted to each output.
    """
    _matching(model, record)
    estimate = _estimate(initial)
    if isinstance(model, StateSpace):
        return _state_space(model, record, estimate, offset)
    out = []
    for y, row in zip(record.outputs, _rows(model), strict=True):
        b = [p for m in row for p in m.b]
        f = [m.denominator(j) for m in row for j in range(len(m.b))]
        out.append(prediction.simulate(record.inputs, y, b, f, estimate=estimate, offset=offset))
    return np.stack(out)


@takes_values
def innovations(model: Noisy, record: Record) -> FloatArray:
    """Return the one-step prediction errors `(ny, n)`, the past before the first sample and a constant fitted.

    Raises:
        InputError: rows made of several models (one record per actuator): which noise is theirs together is unknown.
    """
    _matching(model, record)
    if isinstance(model, InnovationForm):
        return model.innovations(record)
    out = []
    for y, m in zip(record.outputs, single_rows(model, record), strict=True):
        out.append(prediction.innovations(record.inputs, y, m.a, m.b, m.f, m.c, m.d))
    return np.stack(out)


@takes_values
def predicted(model: Noisy, record: Record, steps: int = 1) -> FloatArray:
    """Return the outputs `(ny, n)` predicted `steps` samples ahead: y(t | t - steps).

    y - y_k = sum_{i<k} h_i e(t - i) with h the pulse response of the noise filter C / (A D) (Ljung, eq. 3.31).
    """
    who = "predicted"
    whole(who, "steps", steps, 1)
    if isinstance(model, InnovationForm):
        _matching(model, record)
        return model.predicted(record, steps)
    e = innovations(model, record)
    miss = np.zeros_like(e)
    for i, m in enumerate(single_rows(model, record)):
        h = prediction.filtered(np.eye(1, steps)[0], m.c, np.convolve(m.a, m.d))
        miss[i] = np.convolve(e[i], h)[: e.shape[1]]
    return record.outputs - miss


def _rows(model: PolynomialMatrix | PolynomialModel) -> tuple[tuple[PolynomialModel, ...], ...]:
    return ((model,),) if isinstance(model, PolynomialModel) else model.rows


def single_rows(model: PolynomialMatrix | PolynomialModel, record: Record) -> list[PolynomialModel]:
    """Return the one model of each output; refuse several side by side."""
    for i, row in enumerate(_rows(model)):
        if len(row) != 1:
            raise InputError(
                f"validate: output '{record.sensors[i].name}' has {len(row)} models, each with its own noise, so "
                f"one-step errors are undefined; test one channel with its own record, or compare simulated outputs."
            )
    return [row[0] for row in _rows(model)]


def _matching(model: Model, record: Record) -> None:
    same_rate("validate", "the model", model.rate_hz, "the record", record.rate_hz)
    if isinstance(model, StateSpace):
        ny, nu = model.D.shape
    else:
        rows = _rows(model)
        ny, nu = len(rows), sum(len(m.b) for m in rows[0])
    if (ny, nu) != (len(record.sensors), len(record.actuators)):
        raise InputError(
            f"validate: the model has {nu} inputs and {ny} outputs, the record {len(record.actuators)} and "
            f"{len(record.sensors)}; pick the channels with record.pick."
        )
    if not isinstance(model, PolynomialModel):  # which knows none of its channels
        _same_sides(model, record)
    for kind, side in (("input", "actuators"), ("output", "sensors")):
        theirs = getattr(model, side, ())
        found = moved(getattr(record, side), theirs)
        if found is not None:
            name, here, there = found
            raise InputError(
                f"validate: '{name}' is {kind} {here} of the record and {there} of the model; bring the record's into "
                f"the model's order, {', '.join(c.name for c in theirs)}, with record.pick."
            )
    if not isinstance(model, PolynomialModel):
        _same_units(model, record)


def _same_sides(model: PolynomialMatrix | StateSpace, record: Record) -> None:
    """Refuse an input of the model that is an output of the record alone, or the other way round.

    The model would be driven by what it is to give. A name on both sides of either says nothing.
    """
    ins, outs, driven, heard = (
        [c.name for c in side] for side in (model.actuators, model.sensors, record.actuators, record.sensors)
    )
    for name, here, there in [*((n, "input", "output") for n in ins), *((n, "output", "input") for n in outs)]:
        right, wrong, others = (driven, heard, outs) if here == "input" else (heard, driven, ins)
        if name in wrong and name not in right and name not in others:
            raise InputError(
                f"validate: '{name}' is an {here} of the model, which goes from {', '.join(ins)} to {', '.join(outs)}, "
                f"and an {there} of the record, from {', '.join(driven)} to {', '.join(heard)}; choose the record's "
                "inputs and outputs (--inputs, --outputs) as the model has them."
            )


def _same_units(model: PolynomialMatrix | StateSpace, record: Record) -> None:
    """Refuse channels that meet in two units; one that nobody stated, or that was only numbered, fits any."""
    sides = (("input", model.actuators, record.actuators), ("output", model.sensors, record.sensors))
    for kind, theirs, ours in sides:
        for k, (one, other) in enumerate(zip(theirs, ours, strict=True), 1):
            known = one.unit and other.unit and not is_numbered(one) and not is_numbered(other)
            if known and not same_unit(one.unit, other.unit):
                raise InputError(
                    f"validate: {kind} {k} is '{one.name}' in {one.unit} of the model and '{other.name}' in "
                    f"{other.unit} of the record; choose the channel that is meant, or scale it in a mapping."
                )


def _estimate(initial: str) -> bool:
    if initial not in ("estimate", "rest"):
        raise InputError(f"validate: 'initial' must be 'estimate' or 'rest', got {initial!r}.")
    return initial == "estimate"


def _state_space(model: StateSpace, record: Record, estimate: bool, offset: bool) -> FloatArray:
    if not prediction.can_be_simulated(model.poles(), record.samples):
        return np.full(record.outputs.shape, np.inf)
    out = model.simulate(record.inputs)
    return out + innovation.unknown_past(model.A, model.C, record.outputs - out, estimate=estimate, offset=offset)
