"""What was excited, together or apart, at which lines, and whether it can be told apart."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.errors import InputError
from ultraquiet.spectra.cross import CrossSpectra, moving
from ultraquiet.spectra.estimators import Spectra
from ultraquiet.values import Record

# Below this share of the strongest line an input counts as silent: far above rounding, far below any converter's floor.
SILENT = 1e-12
# Below this share, 50 dB, a line of an input is what a window leaks and converters round: nobody excited it.
EXCITED = 1e-5
# Normalised inputs whose smallest eigenvalue is below this say the same thing: the gains would lose nine of 16 digits.
COLLINEAR = 1e-9


@dataclass(frozen=True, eq=False)
class Group:
    """Cross spectra of records that excite the same `inputs`."""

    cross: CrossSpectra
    inputs: tuple[int, ...]

    def blocks(self, u: Iterable[int], y: Iterable[int], alive: NDArray[np.bool_]) -> Spectra:
        """Return the spectra between the rows `u` and the rows `y` at the lines that live."""
        i, o = list(u), list(y)
        uu, yu, yy = (self.cross.block(a, b)[alive] for a, b in ((i, i), (o, i), (o, o)))
        return Spectra(uu, yu, yy, self.cross.averaging.independent)


def excited_lines(cross: CrossSpectra) -> NDArray[np.bool_]:
    """Return the lines at which each input was excited, `(nu, nf)`: within 50 dB of its strongest line, 0 Hz never."""
    power = cross.power[: len(cross.actuators)]
    strongest = power.max(axis=1, keepdims=True)
    return (power >= EXCITED * strongest) & (strongest > 0) & (cross.f_hz > 0)


def excited_together(records: Sequence[Record]) -> list[tuple[list[Record], tuple[int, ...]]]:
    """Return records in groups that share moving inputs, each with those inputs; an output at rest is refused."""
    for k, sensor in enumerate(records[0].sensors):
        if not any(moving(r.outputs[k : k + 1])[0] for r in records):
            raise _dead("frf", sensor.name)
    groups: list[tuple[list[Record], set[int]]] = []
    for record in records:
        moved = {int(i) for i in np.flatnonzero(moving(record.inputs))}
        if not moved:
            raise InputError("frf: each record must excite at least one input, got one in which none moves.")
        touched = [g for g in groups if g[1] & moved]
        members = [r for g in touched for r in g[0]]
        merged = set[int](moved).union(*(g[1] for g in touched))
        if touched:
            groups[groups.index(touched[0])] = ([*members, record], merged)
            groups = [g for g in groups if g not in touched[1:]]
        else:
            groups.append(([record], merged))
    return [(members, tuple(sorted(inputs))) for members, inputs in groups]


def refuse_dead_outputs(who: str, groups: Sequence[Group]) -> None:
    """Name the output that never moves in any group."""
    nu = len(groups[0].cross.actuators)
    sensors = groups[0].cross.sensors
    heard = {i for g in groups for i in g.cross.moving(range(nu, nu + len(sensors)))}
    for k, sensor in enumerate(sensors, nu):
        if k not in heard:
            raise _dead(who, sensor.name)


def _dead(who: str, name: str) -> InputError:
    return InputError(
        f"{who}: output '{name}' never moves; leave it out (Record.pick) or mend its wire before measuring again."
    )


def alive_lines(who: str, cross: CrossSpectra, rows: Sequence[int]) -> NDArray[np.bool_]:
    """Return the lines `(nf,)` at which all the rows carry power and can be told apart."""
    names = [cross.channels[i].name for i in rows]
    if not rows:
        raise InputError(f"{who}: each record must excite at least one input, got one in which none moves.")
    if cross.averaging.averages < len(rows):
        raise InputError(
            f"{who}: {cross.averaging.averages} segments cannot separate {len(rows)} inputs excited together; "
            f"shorten the segments."
        )
    power = cross.power[list(rows)]
    alive = np.asarray((power > SILENT * power.max(axis=1, keepdims=True)).all(axis=0))
    if not alive.any():
        raise InputError(f"{who}: there is no line at which {', '.join(map(repr, names))} all carry power.")
    if len(rows) > 1:
        size = np.sqrt(power[:, alive].T)
        values, vectors = np.linalg.eigh(cross.block(rows, rows)[alive] / (size[:, :, None] * size[:, None]))
        alike = values[:, 0] < COLLINEAR
        if 2 * np.count_nonzero(alike) > alike.size:
            share = np.median(np.abs(vectors[alike][:, :, 0]), axis=0)
            guilty = [repr(n) for n, part in zip(names, share, strict=True) if part > 0.1 * share.max()]
            raise InputError(
                f"{who}: {' and '.join(guilty)} move alike at {100 * alike.mean():.0f} % of the lines and cannot be "
                f"told apart; excite them by independent signals or one after another."
            )
        alive[alive] = ~alike
    return alive
