"""Flash, RAM and stack of a controller, from the compiled object where a compiler is at hand."""

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.c_code.render import FLAGS
from ultraquiet.deploy.call_graph import stack_bytes
from ultraquiet.deploy.law.law import Law
from ultraquiet.deploy.struct_size import state_bytes
from ultraquiet.deploy.toolchain.compiler import compile_c, compiler, flash_of
from ultraquiet.deploy.toolchain.targets import COMPILER, CORTEX_M7, Target

SIZE_TOOL = "arm-none-eabi-size"
GRAPH = "-fcallgraph-info=su"  # gcc 10 and later


@dataclass(frozen=True)
class Footprint:
    """Bytes of code and constants (without the self-test) and of the deepest stack of a step on a target."""

    flash_bytes: int | None
    stack_bytes: int | None


def footprint(law: Law, files: Mapping[str, str]) -> dict[str, Any]:
    """Return `flash_bytes`, `ram_bytes`, `stack_bytes` and `flash_from`, the compiler whose object was measured.

    RAM is one state struct on a 32-bit target; flash is code and constants without the self-test; stack is that of a
    Cortex-M7, None without its compiler.
    """
    held, source = _measured(law, files)
    flash = held.flash_bytes
    if flash is None:
        flash, source = law.coefficients * np.dtype(law.dtype).itemsize, "constants alone, no compiler"
    ram = state_bytes(files[f"{law.name}.h"], law.name)
    return {"flash_bytes": flash, "ram_bytes": ram, "stack_bytes": held.stack_bytes, "flash_from": source}


def footprint_on(law: Law, folder: Path, target: Target) -> Footprint:
    """Return what the folder's code takes on a target, routines of the compiler's library included in the flash.

    Raises:
        ToolError: the target's compiler is missing or refuses.
    """
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        made, program = Path(work) / "controller.o", Path(work) / "controller.elf"
        compile_c([COMPILER, *FLAGS, *target.flags, GRAPH, "-c", folder / f"{law.name}.c", "-o", made], folder)
        stack = _stack(made, law)
        # memset and memcpy are the program's own, whatever its library
        link = ("-nostdlib", "-nostartfiles", "-Wl,-e,0", "-Wl,--unresolved-symbols=ignore-all")
        compile_c([COMPILER, *target.flags, *link, made, "-lgcc", "-o", program], Path(work))
        return Footprint(flash_of(SIZE_TOOL, program), stack)


def _measured(law: Law, files: Mapping[str, str]) -> tuple[Footprint, str]:
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        folder = Path(work)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        cross = shutil.which(COMPILER)
        if cross is not None and shutil.which(SIZE_TOOL) is not None:
            found = _object(law, folder, (cross, *FLAGS, *CORTEX_M7.flags, GRAPH), SIZE_TOOL)
            if found is not None:
                return found, f"{Path(cross).name} {CORTEX_M7.flags[0]}"
        cc = compiler()
        if cc is not None:
            found = _object(law, folder, (cc, *FLAGS), "size")
            if found is not None:
                return found, f"{Path(cc).name} {FLAGS[1]}"
    return Footprint(None, None), ""


def _object(law: Law, folder: Path, command: Sequence[str], size_tool: str) -> Footprint | None:
    made = folder / "controller.o"
    try:
        compile_c([*command, "-c", f"{law.name}.c", "-o", made], folder)
        flash = flash_of(size_tool, made)
    except ToolError:
        return None
    return None if flash is None else Footprint(flash, _stack(made, law))


def _stack(made: Path, law: Law) -> int | None:
    graph = made.with_suffix(".ci")
    return stack_bytes(graph.read_text(encoding="utf-8"), law.name) if graph.exists() else None
