"""The processes that make stages beside the one that walks a study."""

import os
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager

from ultraquiet._base.beside import Said, beside, numbered
from ultraquiet.pipeline.stage import Cache

WORKER = "ultraquiet.pipeline.making.worker"


def identifying_beside(cache: Cache, wanted: bool) -> AbstractContextManager[Said]:
    """Return a process that identifies the records of a study while this one goes on; see `worker`."""
    title, folder = "compare structures and orders", str(cache.folder)
    return beside(title, WORKER, "identify", folder, wanted=wanted, holds=_lock(cache), say=cache.say)


@contextmanager
def designing_beside(cache: Cache, wanted: bool, jobs: int, *words: str) -> Generator[Said]:
    """Yield processes that design the laws of a study while this one goes on, each taking its next job; see `worker`.

    Args:
        cache: of the study.
        wanted: nothing is run without.
        jobs: how many there are.
        words: `worker`'s: the plan and the units.
    """
    with numbered(jobs) as numbers:
        about = "design", str(cache.folder), str(numbers), *words
        several, holds = min(jobs, os.cpu_count() or 1), (*_lock(cache), numbers)
        title = "design controllers"
        with beside(title, WORKER, *about, wanted=wanted, processes=several, holds=holds, say=cache.say) as said:
            yield said


def _lock(cache: Cache) -> tuple[int, ...]:
    return () if cache.lock is None else (cache.lock,)
