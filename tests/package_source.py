"""The package's source files as syntax trees, parsed once for all tests that read them."""

import ast
import functools
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "ultraquiet"
FILES = sorted(PACKAGE.rglob("*.py"))


@functools.cache
def parsed():
    """Every file of the package with its tree."""
    return tuple((path, ast.parse(path.read_text())) for path in FILES)
