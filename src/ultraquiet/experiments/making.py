"""What a list makes of its tables: registered objects, and a bench that can be asked for its channels."""

from typing import Any

from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.tables import Method, settings_object
from ultraquiet.experiments.mistakes import undefined_in
from ultraquiet.values import Channel


def make(family: str, method: Method, place: Place, mistakes: Mistakes) -> Any | None:
    """Return the registered settings object, or None; every mistake in it is noted."""
    # What stands in a variable that was never set is told already.
    settings = {key: value for key, value in method.settings.items() if not undefined_in(value)}
    pending = method.settings.keys() - settings.keys()
    return settings_object(family, method.method, settings, place, mistakes, pending)


def checked_bench(bench: Any, place: Place, mistakes: Mistakes) -> Any | None:
    """Return a bench whose rate and channels can be asked for, or None with a mistake noted."""
    try:
        sound = float(bench.rate_hz) > 0 and all(isinstance(c, Channel) for c in (*bench.actuators, *bench.sensors))
        said = "its rate is not above zero, or its channels are none"
    except Exception as error:  # as above: a bench may be anybody's
        sound, said = False, f"{type(error).__name__}: {error}"
    if not sound:
        mistakes.add(place, f"{type(bench).__name__} is no bench that can be used here ({said}).")
        return None
    return bench
