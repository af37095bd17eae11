"""Compilers of this machine: found, called, their words passed on."""

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ultraquiet._base.errors import ENDINGS, ToolError

COMPILERS = ("cc", "gcc", "clang")
# No contraction into fused multiply-adds: the same bits on every processor; clang does not tell the source, so we do.
CONTRACT_OFF = ("-ffp-contract=off", "-DULTRAQUIET_CONTRACT_OFF")
FLAGS = ("-std=c99", "-O2", *CONTRACT_OFF, "-Wall", "-Wextra", "-Wconversion", "-Werror")
SECONDS = 120.0  # a generated controller compiles in under one


def compiler() -> str | None:
    """Return the path of a C compiler: that of the environment's CC, else the first of cc, gcc, clang."""
    for name in (os.environ.get("CC", ""), *COMPILERS):
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


def call(command: Sequence[str | Path], folder: Path, seconds: float = SECONDS) -> subprocess.CompletedProcess[str]:
    """Run a program and return what it said, whatever its exit code.

    Raises:
        ToolError: it cannot be started or does not end.
        KeyboardInterrupt: it was asked to end from outside, as is everything then, and says nothing of any code.
    """
    try:
        completed = subprocess.run(
            [str(part) for part in command], cwd=folder, capture_output=True, text=True, timeout=seconds, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ToolError(f"deploy: '{command[0]}' did not run ({error}).") from None
    if -completed.returncode in (signal.SIGINT, *ENDINGS):
        raise KeyboardInterrupt
    return completed


def compile_c(command: Sequence[str | Path], folder: Path) -> None:
    """Run a compiler.

    Raises:
        ToolError: it refused the code, with its first words.
    """
    completed = call(command, folder)
    if completed.returncode != 0:
        words = " ".join(completed.stderr.split())[:400]
        raise ToolError(f"deploy: '{command[0]}' refused the generated code: {words}")


def flash_of(size_tool: str, object_file: Path) -> int | None:
    """Return code and constants of an object in bytes, as `size` counts them; None without the tool."""
    tool = shutil.which(size_tool)
    if tool is None:
        return None
    completed = call([tool, object_file], object_file.parent)
    lines = completed.stdout.splitlines()
    if completed.returncode != 0 or len(lines) < 2:
        return None
    text, data = lines[1].split()[:2]
    return int(text) + int(data)
