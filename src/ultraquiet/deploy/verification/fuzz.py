"""Random bits and random calls under the compiler's sanitizers: no finding, no command beyond its limits."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ultraquiet._base.errors import ToolError
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.c_code.render import constant, render
from ultraquiet.deploy.c_code.self_test import HALF_RANGE
from ultraquiet.deploy.toolchain.compiler import FLAGS, call, compile_c

STEPS = 10_000
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@dataclass(frozen=True)
class Fuzz:
    """Random steps taken, and what was found: a sanitizer's words or a command beyond its limits; empty for nothing."""

    steps: int
    finding: str


def fuzz_code(code: GeneratedCode, cc: str, steps: int = STEPS, seed: int = 0) -> Fuzz:
    """Run the folder's code with random bits at its entrances under the address and undefined-behaviour sanitizers.

    Raises:
        ToolError: the compiler has no sanitizers.
    """
    law, folder = code.law, code.folder
    with tempfile.TemporaryDirectory(prefix="ultraquiet-") as scratch:
        work = Path(scratch)
        (work / "probe.c").write_text("int main(void) { return 0; }\n", encoding="utf-8")
        try:
            compile_c([cc, *SANITIZERS, "probe.c", "-o", "probe"], work)
            able = call([work / "probe"], work).returncode == 0
        except ToolError:
            able = False
        if not able:
            raise ToolError(f"deploy: '{cc}' has no working sanitizers, so nothing was run with random bits.")
        context = {
            "name": law.name,
            "NAME": law.name.upper(),
            "limits": [[constant(v, law.precision) for v in row] for row in law.limits],
            "bits": 8 * np.dtype(law.dtype).itemsize,
            "word": f"uint{8 * np.dtype(law.dtype).itemsize}_t",
            "loud": constant(min(code.plan.loud * HALF_RANGE, 1e30), "float64"),
        }
        (work / "fuzz.c").write_text(render("fuzz.c.j2", context), encoding="utf-8")
        sources = ["fuzz.c", folder / f"{law.name}.c"]
        compile_c([cc, *FLAGS, "-I", folder, *SANITIZERS, *sources, "-o", "fuzz"], work)
        completed = call([work / "fuzz", str(seed), str(steps)], work)
    words = " ".join((completed.stdout + completed.stderr).split())[:300]
    return Fuzz(steps, "" if completed.returncode == 0 else words or f"exit code {completed.returncode}")
