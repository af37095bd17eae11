"""Names, units and limits of blended channels, from those of the bench."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import opening
from ultraquiet.values.channel import Channel


def modes_of(
    rows: FloatArray, wires: Sequence[Channel], given: Sequence[Channel | str] | None, prefix: str
) -> tuple[tuple[Channel, ...], tuple[str, ...]]:
    """Return the modes as channels, and a sentence for each that is blended from several units.

    Args:
        rows: `(modes, wires)`, what each mode is made of; a zero says that a wire has no part in it.
        wires: of the bench.
        given: channels or names, or nothing.
        prefix: of the names that are numbered.

    Raises:
        InputError: another number of modes, two of one name, units that are mixed where no channel says what they make.
    """
    modes = [f"{prefix} {k + 1}" for k in range(len(rows))] if given is None else list(given)
    if len(modes) != len(rows):
        raise InputError(f"Blending: {len(modes)} names were given for {len(rows)} {prefix}s.")
    out: list[Channel] = []
    mixed: list[str] = []
    for row, mode in zip(rows, modes, strict=True):
        units = list(dict.fromkeys(w.unit for w, entry in zip(wires, row, strict=True) if entry))
        name = mode.name if isinstance(mode, Channel) else str(mode)
        if len(units) > 1:
            blend = f"{prefix} '{name}' is blended from {' and '.join(units)}"
            if not isinstance(mode, Channel):
                raise InputError(f"Blending: {blend}; say its unit, Channel('{name}', UNIT), if the matrix converts.")
            mixed.append(f"{opening(blend)}; its matrix must hold the conversion to {mode.unit}.")
        out.append(mode if isinstance(mode, Channel) else Channel(name, units[0]))
    names = [c.name for c in out]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"Blending: two {prefix}s are called '{twice[0]}'; give each a name of its own.")
    return tuple(out), tuple(mixed)


def reading_limits(Ts: FloatArray, sensors: Sequence[Channel], modes: Sequence[Channel]) -> tuple[Channel, ...]:
    """Return the modes with the range that readings within the sensors' limits can reach, where it is finite."""
    return tuple(
        _within(mode, *_reach(row, sensors))  # no reading lies beyond
        for row, mode in zip(Ts, modes, strict=True)
    )


def command_limits(Ta: FloatArray, actuators: Sequence[Channel], modes: Sequence[Channel]) -> tuple[Channel, ...]:
    """Return the modes with limits such that no combination of commands within them passes an actuator's limit.

    Each mode alone may drive its first actuator to the limit; all of them are then lowered by one factor until even
    the worst combination fits. Modes that share no actuator keep the whole of it.

    Raises:
        InputError: an actuator with several modes whose limits do not hold zero inside.
    """
    alone = [_alone(Ta[:, k], actuators) for k in range(Ta.shape[1])]
    spans = [Channel("mode", "", low, high) for low, high in alone]
    factor, shared = 1.0, [(row, w) for row, w in zip(Ta, actuators, strict=True) if np.count_nonzero(row) > 1]
    for row, wire in shared:
        if not wire.low < 0.0 < wire.high:
            raise InputError(
                f"Blending: {np.count_nonzero(row)} modes share actuator '{wire.name}', whose limits {wire.low:g} to "
                f"{wire.in_unit(wire.high)} do not hold zero inside; take its bias out of the command."
            )
        for limit, reach in zip((wire.low, wire.high), _reach(row, spans), strict=True):
            factor = min(factor, limit / reach if np.isfinite(limit) and reach else 1.0)
    lowered = np.any([row != 0 for row, _ in shared], axis=0) if shared else np.zeros(len(alone), dtype=bool)
    scale = np.where(lowered, factor, 1.0)
    return tuple(_within(mode, s * low, s * high) for mode, s, (low, high) in zip(modes, scale, alone, strict=True))


def _alone(column: FloatArray, actuators: Sequence[Channel]) -> tuple[float, float]:
    """Return the range of one mode that drives alone."""
    low, high = -np.inf, np.inf
    for entry, wire in zip(column, actuators, strict=True):
        if entry:
            ends = sorted((wire.low / entry, wire.high / entry))
            low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


def _reach(row: FloatArray, wires: Sequence[Channel]) -> tuple[float, float]:
    """Return the range of a sum over wires within their limits."""
    ends = [sorted((entry * w.low, entry * w.high)) for entry, w in zip(row, wires, strict=True) if entry]
    return sum(e[0] for e in ends), sum(e[1] for e in ends)


def _within(mode: Channel, low: float, high: float) -> Channel:
    return replace(mode, low=max(mode.low, low), high=min(mode.high, high))
