"""Room `cli`: the command line, one file a command.

May be changed here: words, options and how results are printed. No computation: every command calls a room below.
"""

import os
import sys

# Linear algebra here is many small problems: threads inside each of them cost more than they give, and fight with the
# threads that identify channels side by side. Must be set before NumPy loads its BLAS.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

__all__ = ["main"]


def main() -> None:
    """Run the command line; Ctrl-C ends it as it does later, also while half a second of imports is not over."""
    try:
        from ultraquiet.cli.app import main as run
    except KeyboardInterrupt:
        sys.stderr.write("ultraquiet: stopped before it began.\n")
        sys.exit(130)
    run()
