"""Flash, RAM and stack of a controller, from the compiled object where a compiler is at hand."""

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.toolchain.compiler import FLAGS, compile_c, compiler, flash_of
from ultraquiet.deploy.toolchain.target import Target
from ultraquiet.deploy.toolchain.targets import reference_target

GRAPH = "-fcallgraph-info=su"  # gcc 10 and later
ENTRIES = ("output", "update", "frame")
_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(?:\\n(\d+) bytes \((static|dynamic,bounded|dynamic)\))?"')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')
# Members of the state struct, as the header declares them, on a 32-bit target.
_WORD = 4  # bytes of a pointer and of uint32_t
_SIZES = {"uint8_t": 1, "bool": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": _WORD, "int32_t": _WORD}
_WIDE = {"uint64_t": 8, "int64_t": 8, "float": 4, "double": 8}
_MEMBER = re.compile(r"(?:const |volatile )*(\w+) (\*?)\s*(?:const )?(\w+)((?:\[[^]]+\])*);")


@dataclass(frozen=True)
class Footprint:
    """Bytes of code and constants (without the self-test) and of the deepest stack of a step on a target."""

    flash_bytes: int | None
    stack_bytes: int | None


def footprint(law: Law, files: Mapping[str, str]) -> dict[str, Any]:
    """Return `flash_bytes`, `ram_bytes`, `stack_bytes` and `flash_from`, the compiler whose object was measured.

    RAM is one state struct on a 32-bit target; flash is code and constants without the self-test; stack is that of the
    reference target, None without its compiler.

    Raises:
        ToolError: every compiler at hand refuses the code.
    """
    measured, source = _measured(law, files)
    flash = measured.flash_bytes
    if flash is None:
        flash, source = law.coefficients * np.dtype(law.dtype).itemsize, "constants alone, no compiler"
    ram = state_bytes(files[f"{law.name}.h"], law.name)
    return {"flash_bytes": flash, "ram_bytes": ram, "stack_bytes": measured.stack_bytes, "flash_from": source}


def footprint_on(law: Law, folder: Path, target: Target) -> Footprint:
    """Return what the folder's code takes on a target, routines of the compiler's library included in the flash.

    Raises:
        ToolError: the target's compiler is missing or refuses.
    """
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        object_file, program = Path(work) / "controller.o", Path(work) / "controller.elf"
        compile_c(
            [target.family.compiler, *FLAGS, *target.flags, GRAPH, "-c", folder / f"{law.name}.c", "-o", object_file],
            folder,
        )
        stack = _stack(object_file, law)
        # memset and memcpy are the program's own, whatever its library
        link = ("-nostdlib", "-nostartfiles", "-Wl,-e,0", "-Wl,--unresolved-symbols=ignore-all")
        compile_c([target.family.compiler, *target.flags, *link, object_file, "-lgcc", "-o", program], Path(work))
        return Footprint(flash_of(target.family.size_tool, program), stack)


def _measured(law: Law, files: Mapping[str, str]) -> tuple[Footprint, str]:
    """Return what the first compiler that takes the code makes of it, and which one that is.

    Raises:
        ToolError: there are compilers and none takes it.
    """
    refusal = None
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        folder = Path(work)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        target = reference_target()
        cross, size_tool = shutil.which(target.family.compiler), target.family.size_tool
        if cross is not None and shutil.which(size_tool) is not None:
            try:
                measured = _object(law, folder, (cross, *FLAGS, *target.flags, GRAPH), size_tool)
                return measured, f"{Path(cross).name} {target.flags[0]}" if measured.flash_bytes is not None else ""
            except ToolError as error:
                refusal = error
        cc = compiler()
        if cc is not None:
            measured = _object(law, folder, (cc, *FLAGS), "size")
            return measured, f"{Path(cc).name} {FLAGS[1]}"
    if refusal is not None:
        raise refusal
    return Footprint(None, None), ""


def _object(law: Law, folder: Path, command: Sequence[str], size_tool: str) -> Footprint:
    """Return what an object takes; its flash is None where `size` cannot tell.

    Raises:
        ToolError: the compiler refuses the code.
    """
    object_file = folder / "controller.o"
    compile_c([*command, "-c", f"{law.name}.c", "-o", object_file], folder)
    return Footprint(flash_of(size_tool, object_file), _stack(object_file, law))


def _stack(object_file: Path, law: Law) -> int | None:
    graph = object_file.with_suffix(".ci")
    return stack_bytes(graph.read_text(encoding="utf-8"), law.name) if graph.exists() else None


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


def state_bytes(header: str, name: str) -> int | None:
    """Return the size of `struct NAME_state` with the natural alignment of each member; None if it cannot be read.

    >>> text = "typedef float c_real; struct c_state { c_real x[3U]; uint32_t mode; void (*hook)(void); };"
    >>> state_bytes(text, "c")
    20
    """
    plain = re.sub(r"/\*.*?\*/", " ", header, flags=re.DOTALL)
    macros: dict[str, str] = dict(re.findall(r"#define (\w+) (\d+)U?\b", plain))
    sizes = _SIZES | _WIDE
    for kind, alias in re.findall(r"typedef (\w+) (\w+);", plain):
        if kind in sizes:
            sizes[alias] = sizes[kind]
    struct = re.search(rf"struct {name}_state \{{(.*?)\n?\}};", plain, flags=re.DOTALL)
    return _total(struct[1], sizes, macros) if struct else None


def _total(body: str, sizes: dict[str, int], macros: dict[str, str]) -> int | None:
    at, widest = 0, 1
    for line in filter(None, (" ".join(part.split()) for part in body.split(";"))):
        if "(" in line:  # a pointer to a function
            size, count = _WORD, 1
        else:
            member = _MEMBER.fullmatch(line + ";")
            if member is None:
                return None
            size = _WORD if member[2] else sizes.get(member[1], 0)
            count = 1
            for length in re.findall(r"\[(\w+?)U?\]", member[4] or ""):
                count *= int(macros.get(str(length), str(length)))
        if size == 0:
            return None
        at += -at % size + size * count
        widest = max(widest, size)
    return at + -at % widest
