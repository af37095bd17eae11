"""Single settings of a call as the options they belong to."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from ultraquiet._base.errors import InputError

Options = TypeVar("Options")


def collected(
    who: str,
    name: str,
    options: Options | None,
    kind: type[Options],
    settings: Mapping[str, Any],
    *,
    names: Mapping[str, str] | None = None,
    also: Sequence[str] = (),
) -> Options:
    """Return options as they were given, or made of single settings.

    Args:
        who: the call, for its sentences.
        name: of the argument that takes the options whole.
        options: what was given there.
        kind: the dataclass of the options.
        settings: the single settings, by name.
        names: setting -> field; the fields' own names when absent.
        also: further settings of the call, which stand elsewhere.

    Raises:
        InputError: a setting that is none, an object of another kind, or both at once.
    """
    field_of = {field.name: field.name for field in fields(kind)} if names is None else names  # pyright: ignore[reportArgumentType]
    unknown = ", ".join(map(repr, sorted(set(settings) - set(field_of))))
    if unknown:
        raise InputError(f"{who}: there is no setting {unknown}; there are {', '.join([*field_of, *also])}.")
    if options is None:
        return kind(**{field_of[setting]: value for setting, value in settings.items()})
    if not isinstance(options, kind):
        raise InputError(f"{who}: '{name}' must be {kind.__name__}, got {type(options).__name__}.")
    if settings:
        raise InputError(f"{who}: give '{name}' or single settings ({', '.join(settings)}), not both.")
    return options
