"""The table of processors: those of every family that has a folder here."""

import pkgutil
from collections.abc import Iterable
from importlib import import_module

from ultraquiet._base.constraints import one_of
from ultraquiet.deploy import toolchain
from ultraquiet.deploy.toolchain.target import Family, Target

# Whose figures the tables of every law show: the part that laws of this size are flown on.
REFERENCE = "cortex-m7"


def targets_in(folders: Iterable[str]) -> tuple[Target, ...]:
    """Return the processors of every family in these folders, in the order of the families' names."""
    names = sorted(module.name for module in pkgutil.iter_modules(folders) if module.ispkg)
    tables = [import_module(f"{toolchain.__name__}.{name}.processors").TARGETS for name in names]
    return tuple(target for table in tables for target in table)


TARGETS: dict[str, Target] = {target.name: target for target in targets_in(toolchain.__path__)}


def target_named(name: str) -> Target:
    """Return a target by its name.

    >>> target_named("cortex-m7").machine
    'mps2-an500'
    """
    return TARGETS[one_of("deploy", "target", name, tuple(TARGETS))]


def reference_target() -> Target:
    """Return the processor whose footprint and instructions stand in the tables of every law."""
    return TARGETS[REFERENCE]


def families() -> list[tuple[Family, list[Target]]]:
    """Return each family of the table with its processors."""
    members: dict[Family, list[Target]] = {}
    for target in TARGETS.values():
        members.setdefault(target.family, []).append(target)
    return list(members.items())


def missing_program() -> str | None:
    """Return the name of a compiler or emulator of any family that is not installed, None when all are."""
    absent = (family.missing_program() for family, _ in families())
    return next((program for program in absent if program is not None), None)
