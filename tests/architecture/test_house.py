"""The house rules that a machine can check."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src" / "ultraquiet"
FILES = sorted(SRC.rglob("*.py"))
LONGEST_FILE = 400
LONGEST_FUNCTION = 60
IMPORT_BUDGET_S = 0.15
HEAVY = ("numba", "matplotlib", "scipy.signal", "h5py", "pydantic", "jinja2", "typer", "nicegui")


def code_lines(node: ast.AST) -> int:
    """Lines of a function without its docstring."""
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return node.end_lineno - body[0].lineno + 1 if body else 0


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SRC)))
def test_file_is_one_idea(path):
    lines = path.read_text().count("\n")
    assert lines <= LONGEST_FILE, f"{path.name} has {lines} lines; split it by idea"


def test_functions_can_be_read_at_once():
    lengths = sorted(
        (code_lines(node), f"{path.name}:{node.name}")
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    )
    p95 = lengths[int(0.95 * len(lengths))][0]
    print(f"functions: {len(lengths)}, p95 {p95} lines, longest {lengths[-1]}")
    assert p95 < 40
    assert lengths[-1][0] <= LONGEST_FUNCTION, lengths[-5:]


def test_layers():
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(SRC.parents[1] / "pyproject.toml"), no_cache=True) == 0


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
