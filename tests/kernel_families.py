"""Pass the numerical rooms' tests under each of OpenBLAS's kernel families that this processor can run.

    python tests/kernel_families.py [words for pytest]

OpenBLAS picks its kernels by the processor, and they round differently: what holds under one must hold under all.
"""

import os
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# What a processor must know to run each family, as /proc/cpuinfo names it.
FAMILIES = {
    "Nehalem": {"sse4_2"},
    "Haswell": {"avx2", "fma"},
    "Zen": {"avx2", "fma"},
    "SkylakeX": {"avx512f", "avx512dq", "avx512bw", "avx512vl"},
}
ROOMS = ("analyse", "design", "identify", "limits", "linalg", "reduce", "simulate", "spectra", "validate", "values")
ASK = (
    "import numpy, scipy.linalg, threadpoolctl; "
    "print(','.join(sorted({p.get('architecture') or '' for p in threadpoolctl.threadpool_info()})))"
)


def flags() -> set[str]:
    """What this processor says it can do; nothing where it does not say."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    return {word for line in lines if line.startswith("flags") for word in line.split(":")[1].split()}


def main(words: list[str]) -> int:
    """One run of the tests for each family."""
    known, codes, run_as = flags(), {}, {}
    for family, needed in FAMILIES.items():
        if not needed <= known:
            print(f"{family}: not run, this {platform.machine()} processor does not know {sorted(needed - known)}")
            continue
        environment = {**os.environ, "OPENBLAS_CORETYPE": family}
        told = subprocess.run([sys.executable, "-c", ASK], env=environment, capture_output=True, text=True, check=True)
        kernels = told.stdout.strip()
        if kernels in run_as:  # OpenBLAS has one set of kernels for several families
            print(f"\n{family}: the libraries run kernels of {kernels}, as for {run_as[kernels]}", flush=True)
            codes[family] = codes[run_as[kernels]]
            continue
        print(f"\n{family}: the libraries run kernels of {kernels}", flush=True)
        rooms = [f"tests/{room}" for room in ROOMS]
        command = [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "--seed", "1", *rooms, *words]
        codes[family] = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
        run_as[kernels] = family
    print("\n" + ", ".join(f"{family}: {'passed' if code == 0 else 'FAILED'}" for family, code in codes.items()))
    return max(codes.values(), default=0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
