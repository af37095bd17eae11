"""The full ranges of readings and commands, which whole numbers cannot do without."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.one_line import one_line
from ultraquiet.deploy.law.law import actuator_limits, within
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace


def full_ranges(
    who: str, controller: StateSpace, input_v: float | None = None, output_v: ArrayLike | None = None
) -> tuple[float, float]:
    """Return what a full reading and a full command are: as stated, else as the law's channels have it.

    One size serves all: of the readings' ranges the largest, so that none overflows; of the commands' the smallest, so
    that none leaves its own.

    Raises:
        InputError: a size that is not above zero, or that neither caller nor channels state.

    >>> law = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 10.0, actuators=[Channel("speed", "m/s", -2.0, 3.0)])
    >>> full_ranges("deploy", law, output_v=5.0), full_ranges("deploy", law, output_v=[[-4.0, 3.0]])
    ((3.0, 5.0), (3.0, 3.0))
    """
    if input_v is None:
        readings = _known(who, controller.actuators, "can come to", "input_v")
        input_v = max(max(abs(wire.low), abs(wire.high)) for wire in readings)
    limits = command_limits(who, controller, output_v)
    sizes = np.minimum(-limits[:, 0], limits[:, 1])
    if not sizes.min() > 0:
        k = int(np.argmin(sizes))
        wire, (low, high) = controller.sensors[k], limits[k].tolist()
        raise InputError(
            f"{who}: whole numbers hold a command to one size on both sides of zero, and '{wire.name}' goes from"
            f" {low + 0.0:g} to {wire.in_unit(high)}; take precision='float32'."
        )
    return positive(who, "input_v", input_v), float(sizes.min())


def command_limits(who: str, controller: StateSpace, output_v: ArrayLike | None = None) -> FloatArray:
    """Return what each command may come to, `(nu, 2)`: as stated, one size, `(nu,)` or `(nu, 2)`, else its channel's.

    Raises:
        InputError: a size that is not above zero, limits that do not hold zero, or that nobody states.
    """
    if output_v is None:
        wires = _known(who, controller.sensors, "may come to", "output_v")
        return np.array([[wire.low, wire.high] for wire in wires])
    outputs = controller.D.shape[0]
    if np.ndim(output_v) == 0:
        size = positive(who, "output_v", cast("float", output_v))
        return np.tile([-size, size], (outputs, 1))
    return actuator_limits(output_v, outputs, "output_v")


def cut_short(controller: StateSpace, output_v: ArrayLike | None = None) -> str:
    """Return a sentence on commands that may come to more than the one size that holds all; nothing where none may.

    Nothing either where nobody states limits.

    >>> wires = [Channel("coil", "N", -40.0, 30.0), Channel("valve", "N", -30.0, 30.0)]
    >>> law = StateSpace([[0.5]], [[1.0]], [[1.0], [1.0]], [[0.0], [0.0]], 10.0, sensors=wires)
    >>> cut_short(law), cut_short(law, 30.0)
    ('Whole numbers hold all commands to one size, +-30: of coil -40 to 30 N they leave the rest unused.', '')
    """
    if output_v is None and not np.isfinite([(wire.low, wire.high) for wire in controller.sensors]).all():
        return ""
    limits = command_limits("deploy", controller, output_v)
    size = float(np.abs(limits).min())
    more = [
        within(wire, low, high)
        for wire, (low, high) in zip(controller.sensors, limits.tolist(), strict=True)
        if max(-low, high) > size
    ]
    if not more:
        return ""
    return f"Whole numbers hold all commands to one size, +-{size:g}: of {', '.join(more)} they leave the rest unused."


def held_to(size: float, wires: Sequence[Channel]) -> list[str]:
    """Return channels, in the code's order, with the range that full words stand for.

    >>> held_to(2.5, [Channel("push", "N"), Channel("input 2")])
    ['push -2.5 to 2.5 N', 'input 2 -2.5 to 2.5']
    """
    return [within(wire, -size, size) for wire in wires]


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
