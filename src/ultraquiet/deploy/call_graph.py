"""Stack of a step: the deepest chain of calls, from what the compiler writes beside an object."""

import re

ENTRIES = ("output", "update", "frame")
_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(?:\\n(\d+) bytes \((static|dynamic,bounded|dynamic)\))?"')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


def stack_bytes(graph: str, name: str) -> int | None:
    r"""Return the bytes of stack that the longest chain of calls below a step's functions takes.

    Args:
        graph: text of a `.ci` file, which gcc writes with `-fcallgraph-info=su`.
        name: the controller's.

    Returns:
        Bytes; None when the graph is unreadable, a stack has no bound, or functions call each other in a ring. Routines
        of the compiler's own library (soft double, memset) and the overrun hook are not in the graph and not counted.

    >>> stack_bytes('node: { title: "c_output" label: "c_output\\nc.c:1:1\\n24 bytes (static)" }', "c")
    24
    """
    own: dict[str, int] = {}
    for title, size, kind in _NODE.findall(graph):
        if kind == "dynamic":
            return None
        # gcc titles a static function FILE:NAME
        own[title] = int(size or 0)
    calls: dict[str, set[str]] = {}
    for caller, callee in _EDGE.findall(graph):
        calls.setdefault(caller, set()).add(callee)
    depths = [_depth(f"{name}_{entry}", own, calls, ()) for entry in ENTRIES if f"{name}_{entry}" in own]
    if not depths or any(depth is None for depth in depths):
        return None
    return max(depth for depth in depths if depth is not None)


def _depth(at: str, own: dict[str, int], calls: dict[str, set[str]], above: tuple[str, ...]) -> int | None:
    if at in above:
        return None
    below = [_depth(callee, own, calls, (*above, at)) for callee in calls.get(at, ())]
    if any(depth is None for depth in below):
        return None
    return own.get(at, 0) + max((depth for depth in below if depth is not None), default=0)
