"""From a table of a list to the registered object it describes; whatever is wrong with it is noted with its line."""

from dataclasses import MISSING, fields
from typing import Any

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.registry import lookup
from ultraquiet.experiments import command as c
from ultraquiet.experiments.mistakes import Mistakes, undefined_in
from ultraquiet.values import Channel


def make(family: str, method: c.Method, place: Place, mistakes: Mistakes) -> Any | None:
    """Return the registered settings object, or None; every mistake in it is noted.

    Settings that do not exist are noted and left out, so that what comes after is checked all the same.
    """
    try:
        kind = lookup(family, method.method)
    except UltraquietError as error:
        mistakes.add((*place, "method"), str(error))
        return None
    known = {f.name: f for f in fields(kind) if f.init}
    # What stands in a variable that was never set is told already.
    given = {key: value for key, value in method.settings.items() if not undefined_in(value)}
    lacking = method.settings.keys() - given.keys()
    for key in given.keys() - known.keys():
        mistakes.add((*place, key), f"{family} '{method.method}' has no setting '{key}'; known are {', '.join(known)}.")
    for key, field in known.items():
        needed = field.default is MISSING and field.default_factory is MISSING
        if needed and key not in given:
            if key not in lacking:
                mistakes.add(place, f"{family} '{method.method}' lacks its setting '{key}'.")
            return None
    return _built(kind, {key: value for key, value in given.items() if key in known}, place, mistakes)


def _built(kind: type[Any], settings: dict[str, Any], place: Place, mistakes: Mistakes) -> Any | None:
    try:
        return kind(**settings)
    except UltraquietError as error:
        # The sentence names its setting; the line of that setting is where it is mended.
        named = [key for key in settings if f"'{key}'" in str(error)]
        mistakes.add((*place, named[0]) if named else place, str(error))
    except Exception as error:  # a method may be anybody's, and what it is given anything
        mistakes.add(place, f"{kind.__name__} does not take these settings ({type(error).__name__}: {error}).")
    return None


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
