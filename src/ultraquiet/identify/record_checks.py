"""What a record must bring before a model is drawn from it: the checks all methods share."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.health.channels import stuck
from ultraquiet.values import Channel, Record

# Fewer samples a parameter than this leave standard errors of a third and more of the estimate's size.
SAMPLES_PER_PARAMETER = 10
# Of an input's power, what the other inputs leave unexplained at the same sample; less is rounding.
OWN_SHARE = 1e-10
# Of an output's, likewise; a second sensor's own noise at 120 dB below the first still tells the two apart.
OWN_READING = 1e-13
# Readings at their largest or least value, beyond which most of the record is the limit and not the plant. Declared
# limits are repaired; a two-valued output of a noise-free gain is refused as well, it carries a sign and no more.
AT_EXTREMES = 0.2
ONE_READING = 0.5  # share of an output's power in one sample
ONE_LINE = 0.999  # share of an output's power in one straight line: what the plant answers is lost in it
# An output with this share of its power in the last tenth, of inputs that are not louder there, has run away.
RUNAWAY, NO_LOUDER = 0.9, 0.5
# A tone fills six bins of a Blackman-windowed spectrum and carries two parameters; this share of the strongest bin
# stands above the window's own side lobes.
BINS_PER_PARAMETER = 3
LINE_SHARE = 1e-5
# A window that hears less than this share of an input's energy, beside what it would of a steady one, misses the input.
MISSED = 0.1
AT_REST, REST_SAMPLES = 1e-2, 3  # of its largest sample: an input as near to its level so long, first and last, rests


def in_and_out(record: Record) -> list[str]:
    """Return the inputs that move and stand among the outputs as well: a column that was chosen twice."""
    wires = zip(record.actuators, record.inputs, strict=True)
    return [wire.name for wire, sent in wires if np.ptp(sent) > 0 and (record.outputs == sent).all(axis=1).any()]


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
                    f"{who}: {kind} '{wire.name}' is constant at {wire.in_unit(signal[0])}, which no model can be "
                    f"drawn from; excite it, mend it, or leave the channel out: record.pick, --inputs and --outputs, "
                    f"or in a study the bench's channels or [blending]."
                )
    _refuse_copies(who, record)
    _refuse_broken_sensors(who, record)


def outputs_apart(who: str, record: Record) -> None:
    """Refuse outputs that follow from each other, of which no inverse covariance of the errors can be had.

    For searches that weigh by it, and for regressions on the outputs' own past.
    """
    names = _copies(record.outputs, record.sensors, OWN_READING)
    if names:
        raise InputError(
            f"{who}: the outputs {names} follow from each other, so their errors cannot be weighed against each other; "
            f"leave one out with record.pick (--outputs), or fit the simulated error unweighted: 'subspace' with "
            f"weighted=False."
        )


def _refuse_copies(who: str, record: Record) -> None:
    names = _copies(record.inputs, record.actuators, OWN_SHARE)
    if names:
        raise InputError(
            f"{who}: the inputs {names} follow from each other, so their effects cannot be told apart; excite them by "
            f"independent signals, or leave one out with record.pick (--inputs)."
        )


def _copies(signals: FloatArray, wires: tuple[Channel, ...], own: float) -> str:
    """Return the names of signals of which one leaves less than `own` of its power unexplained by the others."""
    if len(signals) == 1:
        return ""
    values, vectors = np.linalg.eigh(np.corrcoef(signals - signals.mean(axis=1, keepdims=True)))
    if values[0] >= own:
        return ""
    copies = np.flatnonzero(np.abs(vectors[:, 0]) > 1e-3 * np.abs(vectors[:, 0]).max())
    return ", ".join(f"'{wires[k].name}'" for k in copies.tolist())


def _refuse_broken_sensors(who: str, record: Record) -> None:
    dead = stuck(record)
    if dead is not None:
        raise InputError(f"{who}: {dead.sentence[0].lower()}{dead.sentence[1:]}")
    for y, wire in zip(record.outputs, record.sensors, strict=True):
        at_limits = np.count_nonzero((y == y.max()) | (y == y.min())) / y.size
        if at_limits > AT_EXTREMES and not np.any((y <= wire.low) | (y >= wire.high)):
            raise InputError(
                f"{who}: {at_limits:.0%} of the readings of output '{wire.name}' stand at its largest or least value, "
                f"{y.max():g} or {wire.in_unit(y.min())}; lower the excitation, or declare the sensor's limits."
            )
        power = (y - np.median(y)) ** 2
        if power.max() > ONE_READING * power.sum():
            raise InputError(
                f"{who}: one reading of output '{wire.name}', sample {int(power.argmax())}, holds "
                f"{power.max() / power.sum():.0%} of its power; cut it out (record.part), or mend the wiring."
            )
        late = _share_of_last_tenth(y)
        if late > RUNAWAY and max(_share_of_last_tenth(u) for u in record.inputs) < NO_LOUDER:
            raise InputError(
                f"{who}: the last tenth of the record holds {late:.0%} of the power of output '{wire.name}', which "
                f"its inputs do not explain: the plant is unstable or the sensor runs away; stabilise it first."
            )
        line = abs(float(np.corrcoef(y, np.arange(y.size))[0, 1])) ** 2
        if line > ONE_LINE:
            raise InputError(
                f"{who}: {line:.3%} of the power of output '{wire.name}' is a straight line; wait until the drift has "
                f"settled, or take it out first."
            )


def _share_of_last_tenth(x: FloatArray) -> float:
    power = (x - np.median(x)) ** 2
    return float(power[-(power.size // 10 + 1) :].sum() / max(power.sum(), np.finfo(float).tiny))


def exciting(who: str, record: Record, parameters: int) -> None:
    """Refuse an input of so few spectral lines that other models fit it as well: a steady tone fixes two parameters."""
    for carried, wire in zip(parameters_carried(record.inputs), record.actuators, strict=True):
        if carried < parameters:
            raise InputError(
                f"{who}: input '{wire.name}' holds spectral lines for about {carried} parameters, the path from it has "
                f"{parameters}; excite a band (noise, chirp, many tones) or lower the order."
            )


def parameters_carried(inputs: FloatArray) -> list[int]:
    """Return about how many parameters of an output the spectral lines of each input tell, two a steady tone.

    >>> t = np.arange(1000)
    >>> parameters_carried(np.sin([0.1 * t, 0.1 * t + np.sin(0.7 * t)]))[0]
    2
    """
    carried = []
    for u in inputs:
        window = np.blackman(u.size)
        carried.append(parameters_of(np.abs(np.fft.rfft(heard_by(window, u - u.mean()) * window)) ** 2))
    return carried


def parameters_of(power: FloatArray) -> int:
    """Return about how many parameters an input of this power at each line tells."""
    return int(np.count_nonzero(power > LINE_SHARE * power.max())) // BINS_PER_PARAMETER


def heard_by(window: FloatArray, u: FloatArray) -> FloatArray:
    """Return an input about zero `(n,)`, turned round until its energy lies in the middle where a window would miss it.

    A blow at the beginning of a record excites as much as one in the middle. Only an input at rest at both ends is
    turned: of one that goes on there, a steady tone, the seam would be a blow of its own.
    """
    energy = u**2
    share = float(window**2 @ energy) / max(float(np.mean(window**2) * energy.sum()), np.finfo(float).tiny)
    level, ends = np.median(u), np.concatenate([u[:REST_SAMPLES], u[-REST_SAMPLES:]])
    if share >= MISSED or np.abs(ends - level).max() > AT_REST * np.abs(u - level).max():
        return u
    middle = np.angle(energy @ np.exp(2j * np.pi * np.arange(u.size) / u.size)) / (2 * np.pi) * u.size
    return np.roll(u, u.size // 2 - round(float(middle)))
