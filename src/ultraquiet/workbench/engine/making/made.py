"""What making an item leaves, and the tables of a study that it may depend on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from ultraquiet._base.errors import InputError
from ultraquiet.pipeline.study import ClosedLoop, Deploy, Requirements


@dataclass(frozen=True)
class Made:
    """Facts, as JSON holds them, and values by name."""

    facts: Mapping[str, Any]
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Tables:
    """Those tables of a study that hold for all its items."""

    closed_loop: ClosedLoop
    deploy: Deploy
    requirements: Requirements | None


def tables_of(state: Mapping[str, Any]) -> Tables:
    """Return the tables of a state, checked.

    Raises:
        InputError: a value that the study file would refuse.
    """
    tables = state["tables"]
    try:
        asked = tables.get("requirements")
        return Tables(
            ClosedLoop.model_validate(tables.get("closed_loop", {})),
            Deploy.model_validate(tables.get("deploy", {})),
            None if asked is None else Requirements.model_validate({"law": state["law"] or "", **asked}),
        )
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"workbench: '{where}' will not do: {first['msg']}.") from error
