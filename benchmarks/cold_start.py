"""`git clone`, `make demo`, `make test` where nothing is installed: exit 0 and in time, set-up included."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Words after `make`, seconds allowed, files left.
RUNS = (
    (("demo",), 130.0, ("demo/report.html", "demo/summary.json")),
    (("demo", "ARGS=--quick"), 90.0, ("demo/report.html", "demo/summary.json")),
    (("test",), 480.0, ()),
)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    for words, limit, files in RUNS:
        with tempfile.TemporaryDirectory() as folder:
            clone = Path(folder) / "ultraquiet"
            subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
            environment = {
                k: v for k, v in os.environ.items() if not k.startswith(("VIRTUAL_ENV", "PYTHON", "OPENBLAS"))
            }
            environment["XDG_CACHE_HOME"] = str(Path(folder) / "cache")  # neither packages nor kernels of before
            started = time.perf_counter()
            done = subprocess.run(["make", *words], cwd=clone, env=environment, capture_output=True, check=False)
            seconds = time.perf_counter() - started
            left = all((clone / name).exists() for name in files)
            kept = done.returncode == 0 and left and seconds < limit
            what = f"git clone, make {' '.join(words)} with {os.cpu_count()} cores"
            if done.returncode:
                print(done.stdout.decode(errors="replace")[-4000:], done.stderr.decode(errors="replace")[-2000:])
            yield what, f"exit {done.returncode}, {seconds:.0f} s", f"exit 0, under {limit:.0f} s", kept
            shutil.rmtree(clone, ignore_errors=True)
