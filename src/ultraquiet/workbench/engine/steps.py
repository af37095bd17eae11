"""The vocabulary of a study by hand: each step is a small table, and what stands on the boards is their sum."""

import re
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import known_are

Step = Mapping[str, Any]
State = dict[str, Any]

BOARDS = ("data", "models", "laws", "codes")
NAME = re.compile(r"(?!open$)[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")
# Of whose values on which board an item is made, by the key of its recipe that names them.
PARENTS = {
    "import": {},
    "measure": {},
    "cut": {"of": "data"},
    "detrend": {"of": "data"},
    "identify": {"records": "data"},
    "design": {"model": "models", "around": "laws"},
    "deploy": {"law": "laws"},
}
BOARD_OF = {
    "import": "data",
    "measure": "data",
    "cut": "data",
    "detrend": "data",
    "identify": "models",
    "design": "laws",
    "deploy": "codes",
}


def empty(title: str) -> State:
    """Return the state of a study in which nothing was done yet."""
    boards: State = {board: {} for board in BOARDS}
    return {"title": title, "tables": {}, "model": None, "law": None, **boards}


def applied(state: State, step: Step) -> State:
    """Return the state after a step.

    Raises:
        InputError: an operation that does not exist, a name that cannot name a file, something the boards do not hold.
    """
    op = step.get("op", "")
    after = deepcopy(state)
    if op in BOARD_OF:
        _put(after, step)
    elif op in _OTHERS:
        _OTHERS[op](after, step)
    else:
        raise InputError(f"workbench: there is no step '{op}'{known_are(str(op), [*BOARD_OF, *_OTHERS])}.")
    return after


def parents(recipe: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return board and name of everything that an item is made of."""
    found: list[tuple[str, str]] = []
    for key, board in PARENTS[recipe["op"]].items():
        named = recipe.get(key) or ()  # a law need not be put round another
        found += [(board, name) for name in ([named] if isinstance(named, str) else named)]
    return found


def _put(state: State, step: Step) -> None:
    recipe = {key: value for key, value in step.items() if key != "name"}
    board, name = BOARD_OF[step["op"]], str(step.get("name", step.get("law", "")))
    if not NAME.fullmatch(name):
        raise InputError(
            f"workbench: '{name}' cannot name an item; take letters, digits, '-', '_' and '.', at most 60, not 'open'."
        )
    for parent_board, parent in parents(recipe):
        if parent not in state[parent_board]:
            raise InputError(f"workbench: the board {parent_board} holds no '{parent}'; make or import it first.")
        if (parent_board, parent) == (board, name):
            raise InputError(f"workbench: '{name}' cannot be made of itself; give the new item another name.")
        if _leads_to(state, parent_board, parent, (board, name)):
            raise InputError(f"workbench: '{parent}' is made of '{name}', so '{name}' cannot be made of it.")
    state[board][name] = recipe
    if board == "models" and state["model"] is None:
        state["model"] = name
    if board == "laws" and state["law"] is None:
        state["law"] = name


def _leads_to(state: State, board: str, name: str, target: tuple[str, str]) -> bool:
    above = parents(state[board][name])
    return any(parent == target or _leads_to(state, *parent, target) for parent in above)


def _choose(state: State, step: Step) -> None:
    for key in ("model", "law"):
        if key in step:
            if step[key] not in state[f"{key}s"]:
                raise InputError(f"workbench: there is no {key} '{step[key]}' to choose.")
            state[key] = step[key]


def _remove(state: State, step: Step) -> None:
    board, name = step["board"], step["name"]
    if board not in BOARDS or name not in state[board]:
        raise InputError(f"workbench: the board {board} holds no '{name}'.")
    users = [user for each in BOARDS for user, recipe in state[each].items() if (board, name) in parents(recipe)]
    if users:
        raise InputError(f"workbench: '{name}' is what {', '.join(users)} was made of; remove that first.")
    del state[board][name]
    for key in ("model", "law"):
        if board == f"{key}s" and state[key] == name:
            state[key] = next(iter(state[board]), None)


def _set_table(state: State, step: Step) -> None:
    if step.get("values") is None:
        state["tables"].pop(step["table"], None)
    else:
        state["tables"][step["table"]] = deepcopy(step["values"])


def _title(state: State, step: Step) -> None:
    state["title"] = str(step["title"])


_OTHERS: dict[str, Callable[[State, Step], None]] = {
    "choose": _choose,
    "remove": _remove,
    "table": _set_table,
    "title": _title,
}
