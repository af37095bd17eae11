"""Imports run downwards and never in a circle, wherever they stand: at the top, in a function, for types alone."""

import ast
import os
import shutil
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

from package_source import PACKAGE, parsed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def graph():
    """Every import of the package, those inside functions and under TYPE_CHECKING included."""
    return grimp.build_graph("ultraquiet", cache_dir=None, exclude_type_checking_imports=False)


def ancestors(module: str) -> set[str]:
    """Packages that hold the module; importing it runs their `__init__` first."""
    parts = module.split(".")
    return {".".join(parts[:k]) for k in range(1, len(parts))}


def loads(graph: grimp.ImportGraph, module: str) -> set[str]:
    """What importing the module needs: modules it names, and the packages on the way to them that it is not in."""
    named = graph.find_modules_directly_imported_by(module)
    named = {name for name in named if name.startswith("ultraquiet")}
    return named | {package for name in named for package in ancestors(name) - ancestors(module) - {module}}


def test_no_module_is_needed_to_load_itself(graph):
    needs = {module: loads(graph, module) for module in graph.modules}
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as circle:
        pytest.fail(f"an import circle: {' <- '.join(circle.args[1])}")


def lazy_imports(modules: set[str]):
    """Modules of the package named by imports inside functions, as (importer, line, module)."""
    for path, tree in parsed():
        importer = ".".join(("ultraquiet", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        functions = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))
        for node in (inner for f in functions for inner in ast.walk(f)):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [name if name in modules else node.module for name in inner]
            else:
                continue
            yield from ((importer, node.lineno, name) for name in names if name in modules)


def test_no_lazy_import_hides_a_circle(graph):
    """An import in a function may save start-up time, never make two modules that need each other loadable."""
    hidden = [
        f"{importer}:{line} imports {name}, which imports it back"
        for importer, line, name in sorted(set(lazy_imports(graph.modules)))
        if name in ancestors(importer) or graph.chain_exists(importer=name, imported=importer)
    ]
    assert not hidden, "\n".join(hidden)


def private_part(module: str) -> str | None:
    """Package that a private module belongs to; `_base` is below everything and open to all."""
    parts = module.split(".")
    for k, part in enumerate(parts[2:], start=2):
        if part.startswith("_"):
            return ".".join(parts[:k])
    return None


def test_private_modules_are_imported_by_their_own_room(graph):
    outsiders = [
        f"{importer} imports {module}"
        for module in sorted(graph.modules)
        if (home := private_part(module))
        for importer in sorted(graph.find_modules_that_directly_import(module))
        if not f"{importer}.".startswith(f"{home}.")
    ]
    assert not outsiders, outsiders


def lint(tree: Path, cache: Path) -> subprocess.CompletedProcess:
    """The contracts of pyproject.toml, checked on the package that stands in `tree`."""
    script = "from importlinter.cli import lint_imports_command as run; run()"
    return subprocess.run(
        [sys.executable, "-c", script, "--cache-dir", str(cache)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree / "src"), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_contracts_hold(tmp_path):
    done = lint(ROOT, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


TOP = "from ultraquiet.values import {0}\n"
IN_A_FUNCTION = "def late():\n    from ultraquiet.values import {0}\n\n    return {0}\n"
FOR_TYPES = "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from ultraquiet.values import {0}\n"


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """The package and its contracts in a folder of their own, with the linter's cache beside it."""
    tree = tmp_path_factory.mktemp("planted")
    shutil.copytree(PACKAGE, tree / "src" / "ultraquiet", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tree)
    return tree


CIRCLE = ("No circle", "No cycles are allowed in ultraquiet.values.")


@pytest.mark.parametrize(
    ("planted", "contract", "said"),
    [
        ({"values/here.py": TOP.format("there"), "values/there.py": TOP.format("here")}, *CIRCLE),
        ({"values/here.py": TOP.format("there"), "values/there.py": IN_A_FUNCTION.format("here")}, *CIRCLE),
        ({"values/here.py": FOR_TYPES.format("there"), "values/there.py": TOP.format("here")}, *CIRCLE),
        ({"values/here.py": "import ultraquiet.report\n"}, "The way of the data", "ultraquiet.values.here"),
        ({"attic/__init__.py": ""}, "The way of the data", "attic"),
        ({"report/here.py": "import ultraquiet.bench._abstract\n"}, "Private", "ultraquiet.report.here"),
    ],
    ids=["circle", "lazy-circle", "circle-of-types", "upwards", "unlisted-room", "private"],
)
def test_a_planted_mistake_is_found(copied, planted, contract, said):
    paths = [copied / "src" / "ultraquiet" / name for name in planted]
    try:
        for path, text in zip(paths, planted.values(), strict=True):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        done = lint(copied, copied / "cache")
    finally:
        for path in paths:
            path.unlink()
            if not any(path.parent.iterdir()):
                path.parent.rmdir()
    broken = [line for line in done.stdout.splitlines() if line.endswith("BROKEN")]
    assert done.returncode == 1, done.stdout + done.stderr
    assert any(line.startswith(contract) for line in broken), broken
    assert said in done.stdout
