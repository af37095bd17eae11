"""The house rules that a machine can check."""

import subprocess
import sys
from pathlib import Path

SRC = Path(__file__).parents[2] / "src" / "ultraquiet"
FILES = sorted(SRC.rglob("*.py"))
IMPORT_BUDGET_S = 0.15
HEAVY = ("numba", "matplotlib", "scipy.signal", "h5py", "pydantic", "jinja2", "typer", "nicegui")


def seconds(statement: str) -> float:
    """Best of five cold starts, without the interpreter's own start."""
    script = f"import time; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"
    runs = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True) for _ in range(5)
    ]
    return min(float(r.stdout) for r in runs)


def test_import_costs_numpy_and_little_more():
    extra = seconds("import numpy; s = time.perf_counter(); import ultraquiet; t += s - t")
    print(f"import ultraquiet: {extra:.3f} s beyond NumPy")
    assert extra < IMPORT_BUDGET_S


def test_import_is_light():
    touch = "import sys, ultraquiet as uq; [getattr(uq, n) for n in ('Record', 'StateSpace')]"
    script = f"{touch}; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_source_names_no_machine():
    paths = [*FILES, *(SRC.parents[1] / "docs").rglob("*.md"), SRC.parents[1] / "README.md"]
    for path in paths:
        text = path.read_text()
        assert "/work/" not in text, path
        assert "/root/" not in text, path
