"""Models for comparison, made by a process of their own while the study's own designs controllers.

Both are held up by Python's one lock where they are threads. What this process leaves is an ordinary stage in the
folder; a study that does not find it there, for whatever reason, makes it itself.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from ultraquiet._base.progress import Task, task

WORKER = "ultraquiet.pipeline.worker"
TITLE = "compare structures and orders"
TICKS = 100  # of its bar


@contextmanager
def identifying(folder: Path, wanted: bool) -> Iterator[Callable[[], object]]:
    """Identify the records of a study folder meanwhile, if `wanted` and there is a second processor.

    Yields what waits until it is done.
    """
    if not wanted or (os.cpu_count() or 1) < 2:
        yield lambda: None
        return
    words = [sys.executable, "-m", WORKER, str(folder)]
    try:
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    except OSError:
        yield lambda: None
        return
    with process, task(TITLE, TICKS) as progress:
        reader = Thread(target=_follow, args=(process, progress), daemon=True)
        reader.start()
        try:
            yield reader.join
        finally:
            process.kill()
            reader.join()


def _follow(process: "subprocess.Popen[str]", progress: Task) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        progress.advance(int(line))
