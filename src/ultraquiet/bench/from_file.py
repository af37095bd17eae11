"""A bench made by a function of the user's own, in a file beside the study."""

import importlib.util
import inspect
import sys
import traceback
from collections.abc import Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, cast

from ultraquiet._base.errors import InputError, SignalExit, UltraquietError
from ultraquiet._base.lines import NO_LINE
from ultraquiet._base.mistakes import TableError
from ultraquiet._base.registry import known_are
from ultraquiet.bench._abstract import Bench

MODULE = "ultraquiet_bench_"  # how modules are called that were read here
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
    module = _module(path, reference)
    make = getattr(module, attribute, None)
    if not callable(make):
        there = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise InputError(
            f"bench '{reference}': '{path.name}' has no callable '{attribute}'{known_are(attribute, there)}."
        )
    given = dict(settings)
    try:
        signature = inspect.signature(make)
        if seed is not None and "seed" in signature.parameters and "seed" not in given:
            given["seed"] = seed
        _require_known(reference, given, signature)
        signature.bind(**given)
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"bench '{reference}': {error}; it takes {inspect.signature(make)}.") from error
    try:
        bench = make(**given)
    except (UltraquietError, SignalExit):
        raise
    except (Exception, SystemExit) as error:
        raise InputError(f"bench '{reference}': {of_a_bench(error) or error}") from error
    if bench is None:
        raise InputError(f"bench '{reference}': it returned nothing; end it with 'return' and the bench.")
    lacking = [member for member in MEMBERS if not hasattr(bench, member)]
    if lacking:
        raise InputError(
            f"bench '{reference}': it returned a {type(bench).__name__} without {', '.join(lacking)}; a bench has "
            f"{', '.join(MEMBERS)}."
        )
    return cast("Bench", bench)


def _require_known(reference: str, given: Mapping[str, Any], signature: inspect.Signature) -> None:
    """Refuse arguments that a callable does not take; all of them are told."""
    if any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values()):
        return
    there = list(signature.parameters)
    unknown = [
        (NO_LINE, f"bench '{reference}': there is no argument '{key}'{known_are(key, there)}; it takes {signature}.")
        for key in given
        if key not in there
    ]
    if unknown:
        raise TableError(f"bench '{reference}'", unknown)


def of_a_bench(error: BaseException) -> str:
    """Return a sentence on an error that a bench's own file raised, with its line; empty on any other.

    A signal may come while that file is at work, and is not of it.

    >>> of_a_bench(ValueError("of somebody else"))
    ''
    """
    frames = [(frame, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    own = [each for each in frames if str(each[0].f_globals.get("__name__", "")).startswith(MODULE)]
    if not own or isinstance(error, SignalExit):
        return ""
    frame, line = own[-1]
    return f"'{Path(frame.f_code.co_filename).name}' raised {type(error).__name__} in line {line}: {error}"


class _AsItStands(SourceFileLoader):
    """Reads the text every time: byte code kept beside it is told from it by size and whole seconds alone."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long for the system
        return False


def _module(path: Path, reference: str) -> ModuleType:
    if not _is_file(path):
        raise InputError(f"bench '{reference}': there is no file '{path}'.")
    spec = importlib.util.spec_from_file_location(f"{MODULE}{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"bench '{reference}': '{path}' is no Python file.")
    if isinstance(spec.loader, SourceFileLoader):
        spec.loader = _AsItStands(spec.name, str(path))
    module = importlib.util.module_from_spec(spec)
    here = str(path.parent.resolve())
    sys.path.insert(0, here)  # what stands beside the file can be imported by it
    try:
        spec.loader.exec_module(module)
    except SignalExit:
        raise
    except (Exception, SystemExit) as error:
        said = of_a_bench(error) or f"'{path.name}' raised {type(error).__name__}: {error}"
        raise InputError(f"bench '{reference}': {said}") from error
    finally:
        sys.path.remove(here)
    return module
