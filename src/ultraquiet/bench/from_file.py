"""A bench made by a function of the user's own, in a file beside the study."""

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet.bench._abstract import Bench

MEMBERS = ("rate_hz", "actuators", "sensors", "run")


def from_file(reference: str, beside: Path, settings: Mapping[str, Any], seed: int | None = None) -> Bench:
    """Return what `CALLABLE(**settings)` of a Python file returns, checked to be a bench.

    Args:
        reference: "FILE.py:CALLABLE".
        beside: folder in which a relative FILE is sought.
        settings: arguments by name.
        seed: handed over as `seed` where the callable takes one and the settings give none.

    Raises:
        InputError: the file cannot be read or raises, has no such callable, takes other arguments, or returns what
            lacks a bench's members.
    """
    name, _, attribute = reference.rpartition(":")
    path = Path(name) if Path(name).is_absolute() else beside / name
    make = getattr(_module(path, reference), attribute, None)
    if not callable(make):
        raise InputError(f"bench '{reference}': '{path.name}' has no callable '{attribute}'.")
    given = dict(settings)
    try:
        signature = inspect.signature(make)
        if seed is not None and "seed" in signature.parameters and "seed" not in given:
            given["seed"] = seed
        unknown = [key for key in given if key not in signature.parameters]
        if unknown and not any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values()):
            raise TypeError(f"there is no argument '{unknown[0]}'")
        signature.bind(**given)
    except (TypeError, ValueError) as error:
        raise InputError(f"bench '{reference}': {error}; it takes {inspect.signature(make)}.") from error
    try:
        bench = make(**given)
    except UltraquietError:
        raise
    except Exception as error:
        raise InputError(f"bench '{reference}': it raised {type(error).__name__}: {error}") from error
    lacking = [member for member in MEMBERS if not hasattr(bench, member)]
    if lacking:
        raise InputError(
            f"bench '{reference}': it returned a {type(bench).__name__} without {', '.join(lacking)}; a bench has "
            f"{', '.join(MEMBERS)}."
        )
    return cast("Bench", bench)


def _module(path: Path, reference: str) -> ModuleType:
    if not path.is_file():
        raise InputError(f"bench '{reference}': there is no file '{path}'.")
    spec = importlib.util.spec_from_file_location(f"ultraquiet_bench_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"bench '{reference}': '{path}' is no Python file.")
    module = importlib.util.module_from_spec(spec)
    here = str(path.parent.resolve())
    sys.path.insert(0, here)  # what stands beside the file can be imported by it
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"bench '{reference}': '{path.name}' raised {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(here)
    return module
