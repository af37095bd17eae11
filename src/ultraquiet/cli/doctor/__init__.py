"""`ultraquiet doctor`: what is installed, what is missing, what is slow, how to mend it."""

import shutil
from collections.abc import Iterator
from importlib import metadata

from ultraquiet._base.errors import ToolError
from ultraquiet._base.provenance import versions
from ultraquiet.cli.doctor import speed
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.text_table import TextTable

PYTHON_PARTS = (
    "numpy",
    "scipy",
    "numba",
    "h5py",
    "pydantic",
    "typer",
    "rich",
    "jinja2",
    "matplotlib",
    "pyuff",
    "clarabel",
    "joblib",
    "pyarrow",
)
OPTIONAL_PARTS = (
    ("npTDMS", "TDMS files", "pip install npTDMS"),
    ("nicegui", "the workbench", "pip install 'ultraquiet[workbench]'"),
    ("distributed", "campaigns on a Dask cluster", "pip install distributed"),
    ("control", "python-control conversion", "pip install control"),
)
TOOLS = (("cc", "compiles and verifies generated controllers", "apt-get install gcc libc6-dev"),)


def doctor() -> None:
    """Say what is installed, missing or slow, and how to mend it; something missing that is needed ends with 1."""
    grid = TextTable(("part", "found", "for", "to mend"))
    grid.add("ultraquiet", versions()["ultraquiet"], "Python " + versions()["python"], "")
    for name in PYTHON_PARTS:
        grid.add(name, _version(name) or "missing", "needed", "" if _version(name) else "make demo")
    for name, use, mend in OPTIONAL_PARTS:
        grid.add(name, _version(name) or "not installed", use, "" if _version(name) else mend)
    for name, use, mend in (*TOOLS, *_emulated()):
        path = shutil.which(name)
        grid.add(name, path or "missing", use, "" if path else mend)
    for row in speed.rows():
        grid.add(*row)
    screen().table(grid)
    screen().result(grid.records())
    missing = [name for name in PYTHON_PARTS if _version(name) is None]
    if missing:
        raise ToolError(f"doctor: {', '.join(missing)} missing, and needed; install this package again.")


def _emulated() -> Iterator[tuple[str, str, str]]:
    """Yield compiler and emulator of every family of processors: program, what it is for, how to get it."""
    from ultraquiet.deploy.toolchain.targets import families

    for family, members in families():
        titles, mend = ", ".join(target.title for target in members), f"apt-get install {' '.join(family.packages)}"
        yield family.compiler, f"cross-compiles for {titles}", mend
        yield family.emulator, f"counts instructions on {titles}", mend


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
