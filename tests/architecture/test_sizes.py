"""What can be read at once: files, functions, folders and names, counted."""

import ast
import functools
from collections import defaultdict
from pathlib import Path
from statistics import median

import pytest

from package_source import FILES, PACKAGE, parsed

LONGEST_FILE, MEDIAN_FILE = 400, 120
LONGEST_FUNCTION, P95_FUNCTION = 60, 31
MOST_PARAMETERS = 10
MOST_FILES = 14
# Rooms that held more than that when the others were divided into folders: none grows.
LARGER_ROOMS = {"experiments": 19, "files": 28, "limits": 19, "linalg": 28, "spectra": 17}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def named(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


@functools.cache
def functions():
    """Every function of the package, methods and inner ones too, with its file."""
    walked = ((path, node) for path, tree in parsed() for node in ast.walk(tree))
    return [(path, node) for path, node in walked if isinstance(node, FUNCTIONS)]


def code_lines(node: ast.AST) -> int:
    """Lines of a function without its docstring."""
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return node.end_lineno - body[0].lineno + 1 if body else 0


def parameters(node: ast.FunctionDef) -> list[str]:
    """What a caller may give: names without `self` and `cls`."""
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return [a.arg for a in every if a is not None and a.arg not in ("self", "cls")]


def is_compiled_or_a_command(node: ast.FunctionDef) -> bool:
    """Kernels take arrays one by one, a command takes one parameter for each of its options."""
    compiled = any("njit" in mark or mark.startswith("compiled") for mark in map(ast.unparse, node.decorator_list))
    return compiled or ast.unparse(node.args).count("typer.") >= len(parameters(node))


@pytest.mark.parametrize("path", FILES, ids=named)
def test_file_is_one_idea(path):
    lines = path.read_text().count("\n")
    assert lines <= LONGEST_FILE, f"{path.name} has {lines} lines; split it by idea"


def test_half_of_the_files_are_short():
    lines = [path.read_text().count("\n") for path in FILES]
    print(f"files: {len(lines)}, median {median(lines):g} lines, longest {max(lines)}")
    assert median(lines) <= MEDIAN_FILE


def test_functions_can_be_read_at_once():
    lengths = sorted((code_lines(node), f"{named(path)}:{node.name}") for path, node in functions())
    p95 = lengths[int(0.95 * len(lengths))][0]
    print(f"functions: {len(lengths)}, p95 {p95} lines, longest {lengths[-1]}")
    assert p95 <= P95_FUNCTION
    assert lengths[-1][0] <= LONGEST_FUNCTION, lengths[-5:]


def test_no_function_takes_more_than_can_be_remembered():
    crowded = {
        f"{named(path)}:{node.name}": len(parameters(node))
        for path, node in functions()
        if len(parameters(node)) > MOST_PARAMETERS and not is_compiled_or_a_command(node)
    }
    assert not crowded, f"more than {MOST_PARAMETERS} parameters, make them a value: {crowded}"


def test_a_public_class_name_means_one_thing():
    homes = defaultdict(list)
    for path, tree in parsed():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(named(path))
    twice = [f"{name}: {', '.join(paths)}" for name, paths in sorted(homes.items()) if len(paths) > 1]
    assert not twice, "\n".join(twice)


def test_no_folder_is_crowded():
    counts = {folder: len(list(folder.glob("*.py"))) for folder in {path.parent for path in FILES}}
    crowded = {
        named(folder): count for folder, count in counts.items() if count > LARGER_ROOMS.get(named(folder), MOST_FILES)
    }
    assert not crowded, f"divide by family: {crowded}"
