"""Flash and RAM of a controller, from the compiled object where a compiler is at hand."""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.targets import COMPILER, CORTEX_M7
from ultraquiet.deploy.emit import FLAGS
from ultraquiet.deploy.law import Law
from ultraquiet.deploy.toolchain import compile_c, compiler, flash_of

COUNTERS = 9  # 32-bit words in the state struct beside its numbers, the hook's pointer included


def footprint(law: Law, files: Mapping[str, str]) -> dict[str, Any]:
    """Return `flash_bytes`, `ram_bytes` and `flash_from`, which names the compiler whose object was measured.

    RAM is one state struct on a 32-bit target; flash is code and constants without the self-test.
    """
    real = np.dtype(law.dtype).itemsize
    numbers = law.states + law.inputs + 3 * law.outputs
    ram = numbers * real + 4 * COUNTERS
    ram += -ram % real
    flash, source = _measured(law, files)
    if flash is None:
        flash, source = law.coefficients * real, "constants alone, no compiler"
    return {"flash_bytes": flash, "ram_bytes": ram, "flash_from": source}


def _measured(law: Law, files: Mapping[str, str]) -> tuple[int | None, str]:
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as work:
        folder = Path(work)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        for cc, size_tool, flags in (
            (shutil.which(COMPILER), "arm-none-eabi-size", (*FLAGS, *CORTEX_M7.flags)),
            (compiler(), "size", FLAGS),
        ):
            if cc is None:
                continue
            made = folder / "controller.o"
            try:
                compile_c([cc, *flags, "-c", f"{law.name}.c", "-o", made], folder)
                flash = flash_of(size_tool, made)
            except ToolError:
                continue
            if flash is not None:
                return flash, f"{Path(cc).name} {' '.join(flags[1:2] if flags is FLAGS else CORTEX_M7.flags[:1])}"
    return None, ""
