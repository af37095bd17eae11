"""Time and temperature of a bench: whether its seconds are ours, how a pause is spent, what its thermometer says."""

import math
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet.bench import Hexapod, Replay, Wrapped

# Benches of this package that compute: they begin every run at rest. Any other bench is taken for a real one unless it
# has an attribute `real_time` that says False, because a pause too many costs less than one left out.
_COMPUTED = (Hexapod, Replay, Wrapped)
_GLANCE_S = 0.1  # how often a pause asks whether it shall end: no user feels it, no processor does


def real_time(bench: Any) -> bool:
    """Return whether a second on the bench is a second on the wall, so that a pause must be waited for.

    A bench says so by an attribute `real_time`; without one, this package's simulated benches are not in real time and
    everything else is.

    >>> real_time(Hexapod()), real_time(object())
    (False, True)
    """
    declared = getattr(bench, "real_time", None)
    return not isinstance(bench, _COMPUTED) if declared is None else bool(declared)


def rest(seconds: float, stop: Callable[[], bool], sleep: Callable[[float], None] = time.sleep) -> None:
    """Spend a pause, or what is left of it until `stop` says yes."""
    end = time.monotonic() + seconds
    while not stop() and (remaining_s := end - time.monotonic()) > 0:
        sleep(min(remaining_s, _GLANCE_S))


def temperature_c(bench: Any) -> float:
    """Return what the bench's thermometer says now, in degrees Celsius.

    Raises:
        InputError: it says nothing that is a number.
    """
    reading = getattr(bench, "temperature_c", None)
    try:
        value = float(reading() if callable(reading) else reading)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"experiment: the thermometer of {type(bench).__name__} says {reading!r}, which is no number.")
    return value


def now() -> str:
    """Return the time in UTC as ISO 8601 writes it, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
