"""Which actuators a list means: numbers from one, names, "each" and "all"."""

from collections.abc import Sequence
from typing import Any

from ultraquiet.values import Channel

# Actuators of this kind are on a bench to disturb it: a signal for "each" or "all" would shake what is being measured.
DISTURBER = "proof mass"


def principal(actuators: Sequence[Channel]) -> list[int]:
    """Return the actuators, counted from 0, that "each" and "all" mean: all but proof masses.

    >>> principal([Channel("strut 1"), Channel("strut 2"), Channel("base proof mass")])
    [0, 1]
    """
    rows = [k for k, channel in enumerate(actuators) if DISTURBER not in channel.name.casefold()]
    return rows or list(range(len(actuators)))


def rows(actuators: Sequence[Channel], meant: Any) -> tuple[list[int], list[str]]:
    """Return the actuators meant, counted from 0, and a sentence for each mistake.

    >>> rows([Channel("left"), Channel("right")], ["right", 3])
    ([1], ['there is no actuator 3; the bench has 1 to 2 (left, right).'])
    """
    if meant in ("each", "all"):
        return principal(actuators), []
    selected: list[int] = []
    faults: list[str] = []
    for one in meant if isinstance(meant, list) else [meant]:
        row = _row(actuators, one)
        if row is None:
            names = ", ".join(channel.name for channel in actuators)
            what = f"actuator {one}" if isinstance(one, int) else f"actuator called '{one}'"
            span = "only 1" if len(actuators) == 1 else f"1 to {len(actuators)}"
            faults.append(f"there is no {what}; the bench has {span} ({names}).")
        elif row in selected:
            faults.append(f"actuator {row + 1}, '{actuators[row].name}', is listed twice.")
        else:
            selected.append(row)
    return selected, faults


def _row(actuators: Sequence[Channel], one: Any) -> int | None:
    if isinstance(one, int):
        return one - 1 if one <= len(actuators) else None
    return next((k for k, channel in enumerate(actuators) if channel.name == one), None)
