"""`ultraquiet deploy --limits` and `--range`: what the commands may come to, and what the readings can."""

import re
from typing import TYPE_CHECKING

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import InputError

if TYPE_CHECKING:
    from ultraquiet.values import StateSpace


def requested_limits(text: str | None, law: "StateSpace") -> FloatArray | None:
    """Return the limits of the commands, `(nu, 2)`, as written; None where nothing is: the law's channels have them.

    Raises:
        InputError: anything but one size, or one size or LOW:HIGH for each command.
    """
    from ultraquiet.deploy.law.law import actuator_limits

    if text is None:
        return None
    words = text.split(",")
    try:
        pairs = [[float(end) for end in word.split(":")] for word in words]
        ranges = np.array([pair if len(pair) == 2 else [-pair[0], *pair] for pair in pairs], dtype=float)
        no_size = any(len(pair) == 1 and not pair[0] > 0 for pair in pairs)
        if no_size or ranges.shape[1] != 2 or len(ranges) not in (1, len(law.sensors)):
            raise ValueError
    except (ValueError, IndexError):
        names = ", ".join(wire.name for wire in law.sensors)
        raise InputError(
            f"deploy: --limits takes one size above zero for all, or such a size or LOW:HIGH for each of {names}; "
            f"got '{text}'."
        ) from None
    return actuator_limits(np.broadcast_to(ranges, (len(law.sensors), 2)), len(law.sensors), "--limits")


def requested_range(text: str | None) -> float | None:
    """Return the full range of the readings, one size for all, as written; None where nothing is.

    Raises:
        InputError: no size above zero.
    """
    if text is None:
        return None
    try:
        size = float(text)
    except ValueError:
        size = 0.0
    if not 0.0 < size < np.inf:
        raise InputError(f"deploy: --range takes one size above zero for all readings, got '{text}'.")
    return size


def require_steps(steps: int) -> None:
    """Refuse a number of samples to compare that is none, or more than memory holds."""
    from ultraquiet.deploy.verification.verify import MOST_STEPS

    whole("deploy", "steps", steps, 1, MOST_STEPS)


def refuse_range(text: str | None, precision: str) -> None:
    """Refuse a range of the readings that code in floating point has no use for."""
    if text is not None:
        raise InputError(f"deploy: --range is for code of whole numbers; code in {precision} takes any reading.")


def as_typed(sentence: str) -> str:
    """Return a sentence of the package with the option that is typed here in place of the setting that it stands for.

    >>> as_typed("fixed_law: state it with input_v (--range).")
    'state it with --range.'
    """
    return re.sub(r"\b\w+_v \((--\w+)\)", r"\1", re.sub(r"^\w+_\w+: ", "", sentence))
