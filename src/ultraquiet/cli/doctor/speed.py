"""What makes this package slow on this machine, and on what it does not run at all."""

import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ultraquiet._base.shown import counted

Row = tuple[str, str, str, str]  # part, found, what it is for, how to mend it
SLOW_BLAS = ("netlib", "reference", "unknown")
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
SYSTEMS = {
    "Linux": ("supported", ""),
    "Darwin": ("not tested", "report what fails; Linux is what releases are tested on"),
    "Windows": ("refused", "use WSL 2, which is Linux: wsl --install"),
}


def rows() -> Iterator[Row]:
    """Yield a row for the system and one for each thing that decides how fast this package is."""
    yield _system()
    yield _linear_algebra(_blas())
    yield _kernels(_cache_folder(), os.environ.get("NUMBA_DISABLE_JIT", "0"))
    yield _processors(os.cpu_count() or 1, _allowed())
    if shutil.which("cc") is None and shutil.which("gcc") is None and shutil.which("clang") is None:
        yield "speed: laws", "slow: no C compiler", "generated code is not proven", "apt-get install gcc libc6-dev"


def _system(name: str | None = None) -> Row:
    name = name or platform.system()
    state, mend = SYSTEMS.get(name, ("not tested", SYSTEMS["Darwin"][1]))
    return "system", f"{name}: {state}", "docs/reference/platforms.md", mend


def _blas() -> list[dict[str, Any]]:
    """Return what linear algebra NumPy and SciPy have loaded."""
    from scipy import linalg
    from threadpoolctl import threadpool_info

    assert linalg  # SciPy brings its own, which is loaded by now
    return [each for each in threadpool_info() if each.get("user_api") == "blas"]


def _linear_algebra(found: list[dict[str, Any]]) -> Row:
    names = sorted({str(each.get("internal_api", "unknown")) for each in found})
    threads = max((int(each.get("num_threads", 1)) for each in found), default=1)
    part, use = "speed: linear algebra", "designs and limits"
    if not found or any(name in SLOW_BLAS for name in names):
        mend = "take the wheels of PyPI: pip install --force-reinstall numpy scipy"
        return part, f"slow: {', '.join(names) or 'no optimised BLAS'}", use, mend
    if threads > (allowed := _allowed()):
        mend = f"export {THREADS[0]}={allowed}"
        return part, f"slow: {threads} threads on {allowed} processors", use, mend
    found_words = f"{', '.join(names)}, {counted(threads, 'thread')}; one inside small solvers"
    return part, found_words, use, ""


def _cache_folder() -> Path:
    from ultraquiet._base.compiled import cache_folder

    return cache_folder()


def _kernels(folder: Path, disabled: str) -> Row:
    part, use = "speed: compiled kernels", "identification, simulated benches"
    if disabled not in ("", "0"):
        return part, "slow: NUMBA_DISABLE_JIT is set", use, "unset NUMBA_DISABLE_JIT"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        mend = "export NUMBA_CACHE_DIR=FOLDER, one that you may write to"
        return part, f"slow: compiled anew each time, '{folder}' cannot be written to", use, mend
    return part, f"kept in {folder}", use, ""


def _allowed() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processors(there: int, allowed: int) -> Row:
    part, use = "speed: processors", "identification and campaigns run on all of them"
    if allowed < there:
        return part, f"slow: {allowed} of {there} may be used", use, "start it without taskset or a container's limit"
    return part, str(there), use, ""
