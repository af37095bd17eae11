"""Packages that only some files need."""

from importlib import import_module
from typing import Any

from ultraquiet._base.errors import ToolError


def extra(module: str, package: str, kind: str) -> Any:
    """Return an optional package, or say in one sentence how to install it."""
    try:
        return import_module(module)
    except ImportError:
        raise ToolError(
            f"files: {kind} files need the package '{package}', which is not installed; "
            f"install it with: pip install {package}"
        ) from None
