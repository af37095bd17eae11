"""`[blending]` of a study file: modes instead of sensors and actuators, a control rate, and what dead channels do."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.tables import Strict
from ultraquiet.bench import Bench, Blended, Decimated
from ultraquiet.identify import Health, channel_health
from ultraquiet.pipeline.tables.matrices import matrix_of
from ultraquiet.pipeline.tables.numbers import Positive
from ultraquiet.values import Blending, Channel, Decimation, Record, StatusWord

Matrix = list[list[Annotated[float, Field(strict=True)]]] | str


class BlendingTable(Strict):
    """`[blending]`: what a study controls instead of single sensors and actuators, and how often.

    Args:
        sensors: Ts, a list of modes, each a list of one number a sensor; or a file beside the study, `.csv` with the
            same rows or `.npz` with an array "sensors". Every sensor by itself when absent.
        actuators: Ta, a list of actuators, each a list of one number a mode; or a file likewise, array "actuators".
        names, unit: of the sensor modes; a unit is needed where several are blended.
        actuator_names, actuator_unit: of the actuator modes.
        control_rate_hz: a whole fraction of the bench's rate; the bench's when absent.
        averages, latency_samples: see `values.Decimation`.
        dead: "leave out" blends without the sensors that the records show to be dead or saturated, "refuse" ends the
            study there.
    """

    sensors: Matrix | None = None
    actuators: Matrix | None = None
    names: list[str] | None = None
    unit: str | None = None
    actuator_names: list[str] | None = None
    actuator_unit: str | None = None
    control_rate_hz: Positive | None = None
    averages: Annotated[int, Field(ge=0, le=8, strict=True)] = 2
    latency_samples: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] | None = None
    dead: Literal["leave out", "refuse"] = "leave out"


@dataclass(frozen=True, eq=False)
class BlendedStudy:
    """What a study goes on with: the bench in modes, its records, and what was seen of the channels.

    Attributes:
        bench: in modes at the control rate; a law designed for its records runs on it as it is.
        records: in modes at the control rate, by name.
        health: of the channels that were recorded.
        left_out: names of sensors that count for nothing.
        sentences: what a user must know: channels that are not ok, what was left out, units that are mixed.
    """

    bench: Any
    records: Mapping[str, Record]
    health: Health
    left_out: tuple[str, ...]
    sentences: tuple[str, ...]


def with_matrices(table: BlendingTable, beside: Path | None) -> BlendingTable:
    """Return the table with its matrices in place of the files that hold them: what is read once cannot change.

    Raises:
        InputError: as `matrix_of`.
    """
    named = {name: getattr(table, name) for name in ("sensors", "actuators")}
    read = {name: matrix_of(name, v, beside).tolist() for name, v in named.items() if isinstance(v, str)}
    return table.model_copy(update=read)


def driven(bench: Bench, table: BlendingTable | None) -> dict[str, Any]:
    """Return what a table changes in the records of a bench, by setting, in plain types; nothing where it changes none.

    These are the modes that are driven and the control rate with its filter. How sensors are blended is none of it:
    each of them is recorded by itself. The table is one of `with_matrices`.

    Raises:
        InputError: as `blended`.
    """
    if table is None:
        return {}
    found: dict[str, Any] = {}
    blending, decimation = _blending(bench, table, None), _decimation(bench.rate_hz, table)
    modes, Ta = blending.actuator_modes, blending.actuator_matrix
    if modes != tuple(bench.actuators) or not np.array_equal(Ta, np.eye(len(modes))):
        found |= {"actuators": Ta.tolist(), "actuator_modes": [[c.name, c.unit] for c in modes]}
    if decimation is not None and decimation.factor > 1:
        found |= {"control_rate_hz": bench.rate_hz / decimation.factor, "averages": decimation.averages}
        found |= {"latency_samples": decimation.latency or decimation.factor}
    return {f"blending.{name}": value for name, value in found.items()}


def blended(bench: Bench, table: BlendingTable, beside: Path | None = None) -> Any:
    """Return the bench that a study records: driven through the modes, every sensor read, at the control rate.

    Single sensors are still there, so that `blended_records` can tell which of them are dead.

    Raises:
        InputError: matrices that do not fit the bench, a control rate that is no whole fraction of its rate.
    """
    whole = _blending(bench, table, beside)
    single = Blending(np.eye(len(bench.sensors)), whole.actuator_matrix, bench.sensors, bench.actuators, bench.sensors)
    wires = _renamed(single, whole.actuator_modes)
    return _decimated(Blended(bench, wires), bench.rate_hz, table)


def in_modes(bench: Bench, table: BlendingTable, left_out: tuple[str, ...] = (), beside: Path | None = None) -> Any:
    """Return the bench that a study identifies and closes loops on: modes in, modes out, at the control rate.

    `left_out` are sensors that count for nothing, by name.

    Raises:
        InputError: matrices that do not fit the bench, a rate that is none of its fractions, too few sensors left.
    """
    return _decimated(Blended(bench, _without(_blending(bench, table, beside), left_out)), bench.rate_hz, table)


def blended_records(
    bench: Bench, table: BlendingTable, records: Mapping[str, Record], beside: Path | None = None
) -> BlendedStudy:
    """Return what a study identifies and closes loops on, without the channels that the records show to be dead.

    Args:
        bench: the bench itself, not the one `blended` returned.
        table: of the study.
        records: made on the bench that `blended` returned, or on the bench itself at its own rate.
        beside: folder of the study file.

    Raises:
        InputError: a dead channel where the table refuses, a dead actuator, too few sensors left for the modes, records
            of other channels or rates.
    """
    if not records:
        raise InputError("blending: no records were given; at least one is needed.")
    blending, decimation = _blending(bench, table, beside), _decimation(bench.rate_hz, table)
    # As they were recorded where they share a rate: a filter would round off what piled up at a limit.
    alike = len({(r.rate_hz, r.actuators) for r in records.values()}) == 1
    health = channel_health([r if alike else _at_the_control_rate(r, bench, decimation) for r in records.values()])
    left_out = _left_out(health, table)
    blending = _without(blending, left_out)
    said = [*health.sentences, *blending.sentences]
    if left_out:
        said.append(f"Left out of the blending: {', '.join(left_out)}; the modes are those of the other sensors.")
    modal = {name: _in_modes(record, bench, blending, decimation) for name, record in records.items()}
    return BlendedStudy(in_modes(bench, table, left_out, beside), modal, health, left_out, tuple(said))


def _without(blending: Blending, left_out: tuple[str, ...]) -> Blending:
    return blending.without(sensors=left_out) if left_out else blending


def _renamed(blending: Blending, actuator_modes: tuple[Channel, ...]) -> Blending:
    """Return a blending whose actuator modes are called and limited as given."""
    sensors, actuators = blending.sensors, blending.actuators
    matrices = blending.sensor_matrix, blending.actuator_matrix
    return Blending(*matrices, sensors, actuators, blending.sensor_modes, actuator_modes)


def _left_out(health: Health, table: BlendingTable) -> tuple[str, ...]:
    """Return the sensors to leave out; an actuator that does nothing has spoilt the modes it is part of."""
    dead, saturated = health.named(StatusWord.DEAD), health.named(StatusWord.SATURATED)
    faults = [*dead[0], *saturated[0], *dead[1]]
    if dead[1] or (faults and table.dead == "refuse"):
        sentences = [s.sentence for s in (*health.sensor_statuses, *health.actuator_statuses) if not s.ok]
        raise InputError(f"blending: {' '.join(sentences)} Nothing was identified.")
    return (*dead[0], *saturated[0])


def _blending(bench: Bench, table: BlendingTable, beside: Path | None) -> Blending:
    ny, nu = len(bench.sensors), len(bench.actuators)
    Ts = np.eye(ny) if table.sensors is None else matrix_of("sensors", table.sensors, beside)
    Ta = np.eye(nu) if table.actuators is None else matrix_of("actuators", table.actuators, beside)
    given = (
        _modes(Ts, bench.sensors, table.names, table.unit, "sensor mode"),
        _modes(Ta.T, bench.actuators, table.actuator_names, table.actuator_unit, "actuator mode"),
    )
    try:
        return Blending(Ts, Ta, bench.sensors, bench.actuators, *given)
    except InputError as error:  # in the words of the table
        said = str(error).removeprefix("Blending: ")
        raise InputError(
            f"blending: {said.replace('sensor_matrix', 'sensors').replace('actuator_matrix', 'actuators')}"
        ) from None


def _modes(
    rows: FloatArray, wires: tuple[Channel, ...], names: list[str] | None, unit: str | None, prefix: str
) -> list[Channel] | list[str] | tuple[Channel, ...] | None:
    """Return modes by name, as channels where a unit is given; the bench's own where nothing is blended."""
    if names is None and unit is None and np.array_equal(rows, np.eye(len(wires))):
        return wires
    called = names if names is not None else [f"{prefix} {k + 1}" for k in range(len(rows))]
    return called if unit is None else [Channel(name, unit) for name in called]


def _decimation(rate_hz: float, table: BlendingTable) -> Decimation | None:
    if table.control_rate_hz is None:
        return None
    return Decimation.to(table.control_rate_hz, rate_hz, table.averages, table.latency_samples)


def _decimated(bench: Any, rate_hz: float, table: BlendingTable) -> Any:
    decimation = _decimation(rate_hz, table)
    return bench if decimation is None or decimation.factor == 1 else Decimated(bench, decimation)


def _at_the_control_rate(record: Record, bench: Bench, decimation: Decimation | None) -> Record:
    """Return a record at the control rate, one at the bench's own filtered and decimated."""
    if decimation is None or decimation.factor == 1 or record.rate_hz != bench.rate_hz:
        return record
    return decimation.record(record)


def _in_modes(record: Record, bench: Bench, blending: Blending, decimation: Decimation | None) -> Record:
    """Return a record in modes; its commands may be the modes' already."""
    slow = _at_the_control_rate(record, bench, decimation)
    asked = bench.rate_hz / (1 if decimation is None else decimation.factor)
    if abs(slow.rate_hz - asked) > 1e-9 * asked:
        raise InputError(
            f"blending: a record is sampled at {slow.rate_hz:g} Hz, neither the bench's {bench.rate_hz:g} Hz nor the "
            f"control rate, {asked:g} Hz; record it again."
        )
    if [c.name for c in slow.actuators] != [c.name for c in blending.actuator_modes]:
        return blending.record(slow)
    modes = np.eye(len(blending.actuator_modes))
    outer = Blending(blending.sensor_matrix, modes, blending.sensors, slow.actuators, blending.sensor_modes)
    return _renamed(outer, blending.actuator_modes).record(slow)
