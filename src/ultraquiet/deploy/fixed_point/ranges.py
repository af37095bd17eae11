"""The full ranges of readings and commands, which whole numbers cannot do without."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.one_line import one_line
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace


def full_ranges(
    who: str, controller: StateSpace, input_v: float | None = None, output_v: float | None = None
) -> tuple[float, float]:
    """Return what a full reading and a full command are: as stated, else as the law's channels have it.

    One size serves all: of the readings' ranges the largest, so that none overflows; of the commands' the smallest, so
    that none leaves its own.

    Raises:
        InputError: a size that is not above zero, or that neither caller nor channels state.

    >>> law = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 10.0, actuators=[Channel("speed", "m/s", -2.0, 3.0)])
    >>> full_ranges("deploy", law, output_v=5.0)
    (3.0, 5.0)
    """
    if input_v is None:
        readings = _known(who, controller.actuators, "can come to", "input_v")
        input_v = max(max(abs(wire.low), abs(wire.high)) for wire in readings)
    if output_v is None:
        wires = _known(who, controller.sensors, "may come to", "output_v")
        sizes = [min(-wire.low, wire.high) for wire in wires]
        output_v = min(sizes)
        if not output_v > 0:
            wire = wires[int(np.argmin(sizes))]
            raise InputError(
                f"{who}: whole numbers hold a command to one size on both sides of zero, and '{wire.name}' goes from"
                f" {wire.low:g} to {wire.in_unit(wire.high)}; take precision='float32'."
            )
    return positive(who, "input_v", input_v), positive(who, "output_v", output_v)


def full_size(size: float, wires: Sequence[Channel]) -> str:
    """Return what a full word is as a comment of C says it, in each of the units of its channels where one is stated.

    >>> full_size(2.5, [Channel("push", "N"), Channel("pull", "N")]), full_size(2.5, [Channel("input 1")])
    ('2.5 N', '2.5')
    >>> full_size(2.5, [Channel("push", "N"), Channel("coil", "A")])
    '2.5 (N, A)'
    """
    units = [one_line(unit).replace("/*", "/ *").replace("*/", "* /") for unit in dict.fromkeys(w.unit for w in wires)]
    if len(units) < 2:
        return f"{size:g} {''.join(units)}".rstrip()
    return f"{size:g} ({', '.join(unit or 'no unit' for unit in units)})"


def _known(who: str, wires: tuple[Channel, ...], what: str, setting: str) -> tuple[Channel, ...]:
    unknown = [wire.name for wire in wires if not np.isfinite([wire.low, wire.high]).all()]
    if unknown:
        option = {"input_v": "--range", "output_v": "--limits"}[setting]
        raise InputError(
            f"{who}: whole numbers need a range, and nobody says what '{', '.join(unknown)}' {what}; state"
            f" it with {setting} ({option}) or take precision='float32'."
        )
    return wires
