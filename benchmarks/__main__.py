"""Run benchmarks, print their figures beside the targets, and fail when one falls short.

python -m benchmarks [NAME ...]
"""

import importlib
import os
import pkgutil
import sys
from pathlib import Path

for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def main(names: list[str]) -> int:
    every = [m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)]) if not m.name.startswith("_")]
    unknown = [n for n in names if n not in every]
    if unknown:
        print(f"benchmarks: there is no '{unknown[0]}'; known are {', '.join(every)}.")
        return 2
    missed = 0
    for name in names or every:
        for what, measured, target, kept in importlib.import_module(f"benchmarks.{name}").measure():
            print(f"{'kept  ' if kept else 'MISSED'}  {name:<16} {what:<66} {measured:<28} target {target}", flush=True)
            missed += not kept
    print(f"{missed} of the promises above were missed." if missed else "Every promise was kept.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
