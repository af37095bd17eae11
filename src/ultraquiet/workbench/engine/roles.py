"""What the columns of a file are, guessed from what they are called and what they are measured in."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

INPUT, OUTPUT = "input", "output"
# What a name says itself, and quantities that are rather sent or rather read: `force sensor` is read.
SAYS = {
    INPUT: {"input", "inputs", "in", "u", "command", "commands", "cmd", "drive", "drives", "driver", "setpoint",
            "excitation", "shaker", "exciter", "hammer", "actuator", "amplifier"},
    OUTPUT: {"output", "outputs", "out", "y", "reading", "readings", "sensor", "accelerometer", "geophone", "gauge",
             "encoder", "laser", "pickup", "probe", "microphone", "response", "measured"},
}  # fmt: skip
RATHER = {
    INPUT: {"force", "current", "voltage", "torque", "coil", "motor", "piezo", "valve"},
    OUTPUT: {"accel", "acceleration", "acc", "velocity", "vel", "speed", "position", "pos", "displacement", "disp",
             "gap", "angle", "strain", "temperature", "pressure"},
}  # fmt: skip
UNIT = re.compile(r"([numkMGµμ]?)(A|V|N|Nm|N m|g|(?:m|rad|deg)(?:/s(?:\^?2|²)?)?)")
DRIVES = ("A", "V", "N", "Nm", "N m")
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def guessed_roles(channels: Sequence[Mapping[str, Any]]) -> tuple[list[str], str]:
    """Return what each column is, `input` or `output`, and a sentence where that is not sure.

    What the file says holds; then what a name says; then its unit, an ampere is sent and a metre read. The others
    are what stands beside them is, or the side that is missing; where nothing tells columns apart, those in the
    first one's unit go in.

    >>> columns = [{"name": n, "unit": u, "role": ""} for n, u in (("a", "A"), ("b", "A"), ("c", "V"), ("d", "m/s"))]
    >>> guessed_roles(columns)
    (['input', 'input', 'input', 'output'], '')
    """
    told = [each["role"] or _named(each["name"], SAYS) for each in channels]
    meant = [_named(each["name"], RATHER) for each in channels]
    measured = [_measured(each["unit"]) for each in channels]
    if set(measured) - {""} == {INPUT}:  # volts alone may be sent and read
        measured = [""] * len(channels)
    found = [a or b or c for a, b, c in zip(told, measured, meant, strict=True)]
    at_odds = [not a and bool(b and c and b != c) for a, b, c in zip(told, measured, meant, strict=True)]
    unsure = {k for k, role in enumerate(found) if not role} | {k for k, odd in enumerate(at_odds) if odd}
    known = set(found) - {""}
    if len(known) == 2:
        made = _between(found)
    elif known and unsure:  # a record has both: what is not told is the other side
        made = [role or (OUTPUT if INPUT in known else INPUT) for role in found]
    else:
        made, unsure = _by_first_unit(channels), set(range(len(channels)))
    return made, _doubt([channels[k]["name"] for k in sorted(unsure)])


def _named(name: str, words: Mapping[str, set[str]]) -> str:
    """Return what the last telling word of a name says, which is what the thing is.

    >>> _named("forceSensor 2", SAYS), _named("position command", SAYS), _named("u_1", SAYS), _named("strut", SAYS)
    ('output', 'input', 'input', '')
    """
    said = [role for word in WORD.findall(name) for role, some in words.items() if word.lower() in some]
    return said[-1] if said else ""


def _measured(unit: str) -> str:
    """Return what a unit says: drives are sent, motions read.

    >>> _measured("mA"), _measured("µm/s"), _measured("m/s^2"), _measured("1")
    ('input', 'output', 'output', '')
    """
    found = UNIT.fullmatch(unit.strip())
    if found is None:
        return ""
    return INPUT if found[2] in DRIVES else OUTPUT


def _between(found: Sequence[str]) -> list[str]:
    """Return the roles with the untold ones as the nearest told before them, or else after them."""
    first = next(role for role in found if role)
    made: list[str] = []
    for role in found:
        made.append(role or (made[-1] if made else first))
    return made


def _by_first_unit(channels: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the roles of columns that nothing tells apart: commands come first in most files."""
    units = [each["unit"] for each in channels]
    alike = units[0] != units[-1]
    return [INPUT if k == 0 or (alike and unit == units[0]) else OUTPUT for k, unit in enumerate(units)]


def _doubt(names: Sequence[str]) -> str:
    """Return the sentence that says of which columns the role is not sure.

    >>> _doubt(["a", "b", "c", "d"])
    'Neither name nor unit tells for sure what a, b, c and 1 more are: see whether they are commands or readings.'
    """
    if not names:
        return ""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    are, they = ("is", "it is a command or a reading") if len(names) == 1 else ("are", "they are commands or readings")
    return f"Neither name nor unit tells for sure what {', '.join(names[:3])}{more} {are}: see whether {they}."
