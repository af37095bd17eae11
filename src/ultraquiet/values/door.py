"""The door for systems: what a verb is handed becomes a `StateSpace`, or is refused in one sentence."""

import inspect
from collections.abc import Callable
from functools import lru_cache, wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar, get_args

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.values.state_space import StateSpace

P = ParamSpec("P")
R = TypeVar("R")
HUGE = 1e152  # sums of squares of entries beyond it overflow


def system(who: str, name: str, value: Any) -> StateSpace:
    """Return a system as a `StateSpace`.

    Args:
        who: the verb, for the sentence of a refusal.
        name: of the argument.
        value: a `StateSpace`; a system of python-control, transfer functions too; or anything with `state_space()`.

    Raises:
        InputError: anything else, and entries so large that their squares overflow.

    >>> system("hinf_norm", "G", None)
    Traceback (most recent call last):
    ...
    ultraquiet._base.errors.InputError: hinf_norm: 'G' must be a StateSpace or a system of python-control, got NoneType.
    """
    found = value if isinstance(value, StateSpace) else _converted(value)
    if found is None:
        raise InputError(
            f"{who}: '{name}' must be a StateSpace or a system of python-control, got {type(value).__name__}."
        )
    largest = max(float(np.abs(M).max(initial=0.0)) for M in (found.A, found.B, found.C, found.D))
    if largest > HUGE:
        raise InputError(f"{who}: '{name}' has an entry of {largest:.1e}, whose square overflows; choose other units.")
    return found


def _converted(value: Any) -> StateSpace | None:
    try:
        if callable(getattr(value, "state_space", None)):
            made = value.state_space()
            return made if isinstance(made, StateSpace) else None
        # only where python-control is there already can an object be one of its systems
        if type(value).__module__.split(".")[0] == "control" and isinstance(value, import_module("control").LTI):
            return StateSpace.from_control(value)
    except (TypeError, AttributeError):
        return None
    return None


def takes_systems(verb: Callable[P, R]) -> Callable[P, R]:
    """Let every argument that a function annotates as `StateSpace`, or as that or None, come through the door.

    >>> @takes_systems
    ... def states(G: StateSpace) -> int:
    ...     return G.states
    >>> states(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]]))
    1
    """

    @wraps(verb)
    def through(*args: P.args, **kwargs: P.kwargs) -> R:
        positions, optional, method = _systems_of(verb)
        who = type(args[0]).__name__ if method and args else verb.__name__
        passed: list[Any] = list(args)
        named: dict[str, Any] = dict(kwargs)
        for name, k in positions.items():
            if k < len(passed):
                if not (passed[k] is None and name in optional):
                    passed[k] = system(who, name, passed[k])
            elif name in named and not (named[name] is None and name in optional):
                named[name] = system(who, name, named[name])
        return verb(*passed, **named)  # type: ignore[arg-type]

    return through


@lru_cache(maxsize=256)
def _systems_of(verb: Callable[..., Any]) -> tuple[dict[str, int], frozenset[str], bool]:
    """Return the places of the arguments that are systems, those that may be None, and whether it is a method."""
    parameters = inspect.signature(verb).parameters
    places: dict[str, int] = {}
    optional: set[str] = set()
    for k, (name, parameter) in enumerate(parameters.items()):
        kinds = get_args(parameter.annotation)
        if parameter.annotation is StateSpace or set(kinds) == {StateSpace, type(None)}:
            places[name] = k
            if kinds:
                optional.add(name)
    return places, frozenset(optional), "self" in parameters


__all__ = ["system", "takes_systems"]
