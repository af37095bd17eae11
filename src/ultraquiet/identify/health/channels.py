"""The verdict on every channel of a bench, from its records: ok, dead or saturated, with a sentence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.identify.health.answers import answers, tells
from ultraquiet.identify.health.waveforms import piled_up, standstill
from ultraquiet.values import Channel, Record, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

# A channel that carries nothing but noise passes for a live one so often; one that answers at all reaches far less.
SIGNIFICANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Health:
    """What records tell of the channels they were made with.

    Attributes:
        sensors, actuators: the channels.
        sensor_statuses, actuator_statuses: `ok`, `dead` or `saturated` with a sentence that names the channel, says why
            and what would do.
        sensor_p, actuator_p: p-values that the channel has nothing to do with the others, `(ny,)` and `(nu,)`.
    """

    sensors: tuple[Channel, ...]
    actuators: tuple[Channel, ...]
    sensor_statuses: tuple[Status, ...]
    actuator_statuses: tuple[Status, ...]
    sensor_p: FloatArray
    actuator_p: FloatArray

    @property
    def ok(self) -> bool:
        """True when every channel is."""
        return not self.sentences

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence for every channel that is not ok, sensors first."""
        return tuple(s.sentence for s in (*self.sensor_statuses, *self.actuator_statuses) if not s.ok)

    def named(self, word: StatusWord) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the names of the sensors, and of the actuators, whose status has a word."""
        pairs = (self.sensors, self.sensor_statuses), (self.actuators, self.actuator_statuses)
        sensors, actuators = (
            tuple(c.name for c, s in zip(wires, statuses, strict=True) if s.word is word) for wires, statuses in pairs
        )
        return sensors, actuators


@takes_values
def channel_health(records: Sequence[Record]) -> Health:
    """Return what records tell of each channel: dead, saturated or ok.

    A sensor is dead when it stands still while the actuators move, or when nothing that it reads, in any record, has to
    do with any of them (`answers`). An actuator is dead when no sensor answers to it in any record, or when no record
    drives it. A channel is saturated when its samples pile up at its limits or, of a sensor, at a largest or least
    value of its own. Every threshold is a share of the record or a level of significance: no unit and no bench decides.

    Args:
        records: one or more of one bench, open loop, its actuators driven together or one by one.

    Raises:
        InputError: no records, or records of different channels.
        RateError: records of different rates.

    >>> rng = np.random.default_rng(0)
    >>> u, noise = rng.standard_normal((1, 2000)), rng.standard_normal((2, 2000))
    >>> record = Record(u, np.vstack([u, 0 * u]) + noise, 1000.0, sensors=["near", "unplugged"])
    >>> channel_health([record]).named(StatusWord.DEAD)
    (('unplugged',), ())
    """
    _alike(records)
    tested = [answers(record) for record in records]
    sensor_p = np.minimum(len(records) * np.min([p for p, _ in tested], axis=0), 1.0)
    pairs = np.minimum(len(records) * np.min([p for _, p in tested], axis=0), 1.0)
    actuator_p = np.minimum(pairs.shape[0] * pairs.min(axis=0), 1.0)
    told = any(tells(record) for record in records)
    first = records[0]
    return Health(
        first.sensors,
        first.actuators,
        tuple(_sensor(records, i, float(sensor_p[i]), told) for i in range(len(first.sensors))),
        tuple(_actuator(records, j, float(actuator_p[j]), told) for j in range(len(first.actuators))),
        sensor_p,
        actuator_p,
    )


def stuck(record: Record) -> Status | None:
    """Return the verdict on the first sensor that stands still while the actuators move, None where none does."""
    for y, wire in zip(record.outputs, record.sensors, strict=True):
        found = standstill(y, record.inputs)
        if found is not None:
            part = (found.stop - found.start) / y.size
            return _dead(
                f"Sensor '{wire.name}' is dead in part: it stands still at {wire.in_unit(found.value)} from sample "
                f"{found.start} to {found.stop} ({part:.0%} of the record) while the actuators move; check its cable "
                f"and supply, use the rest (record.part), or leave it out."
            )
    return None


def _sensor(records: Sequence[Record], i: int, p: float, told: bool) -> Status:
    wire = records[0].sensors[i]
    name = f"Sensor '{wire.name}'"
    if all(np.ptp(r.outputs[i]) == 0 for r in records):
        return _dead(
            f"{name} is dead: it stands at {wire.in_unit(records[0].outputs[i, 0])} in every record; check its cable "
            f"and supply, or leave it out."
        )
    still = [status for r in records if (status := stuck(r.pick(outputs=[i]))) is not None]
    if still:
        return still[0]
    if told and p >= SIGNIFICANCE:
        rms = max(float(np.std(r.outputs[i])) for r in records)
        return _dead(
            f"{name} is dead: nothing of its {wire.in_unit(rms, 3)} RMS has to do with any actuator (p = {p:.2g}); "
            f"check its cable and supply, excite more strongly, or leave it out."
        )
    return _piled([r.outputs[i] for r in records], wire, name, "lower the excitation or widen its range", True)


def _actuator(records: Sequence[Record], j: int, p: float, told: bool) -> Status:
    wire = records[0].actuators[j]
    name = f"Actuator '{wire.name}'"
    if all(np.ptp(r.inputs[j]) == 0 for r in records):
        return _dead(f"{name} is driven in no record, so nothing is known of it; drive it, or leave it out.")
    if told and p >= SIGNIFICANCE:
        return _dead(
            f"{name} is dead: no sensor answers to it (p = {p:.2g}); check its amplifier and cable, drive it more "
            f"strongly, or leave it out."
        )
    return _piled([r.inputs[j] for r in records], wire, name, "lower the excitation", False)


def _piled(signals: Sequence[FloatArray], wire: Channel, name: str, mend: str, beyond: bool) -> Status:
    count, end = max((piled_up(x, wire, beyond) for x in signals), key=lambda found: found[0])
    if not count:
        return Status(StatusWord.OK, f"{name} is alive.")
    share = count / sum(x.size for x in signals)
    return Status(
        StatusWord.SATURATED,
        f"{name} is saturated: {share:.2%} of its samples or more stand at {wire.in_unit(end)}; {mend}.",
    )


def _dead(sentence: str) -> Status:
    return Status(StatusWord.DEAD, sentence)


def _alike(records: Sequence[Record]) -> None:
    if not records:
        raise InputError("channel_health: no records were given; at least one is needed.")
    for number, record in enumerate(records[1:], start=2):
        same_rate("channel_health", "record 1", records[0].rate_hz, f"record {number}", record.rate_hz)
        first, other = ([c.name for c in (*r.actuators, *r.sensors)] for r in (records[0], record))
        if first != other:
            raise InputError(
                f"channel_health: record {number} has other channels than record 1; judge each bench alone."
            )
