"""The processes that make stages beside the one that walks a study."""

from contextlib import AbstractContextManager

from ultraquiet._base.beside import Said, beside
from ultraquiet.pipeline.stage import Cache

WORKER = "ultraquiet.pipeline.making.worker"
TITLES = {"identify": "compare structures and orders", "design": "design controllers"}


def working_beside(cache: Cache, job: str, wanted: bool, *words: str) -> AbstractContextManager[Said]:
    """Return a process that leaves stages in the folder of a study while this one goes on; see `worker`."""
    folder = str(cache.folder)
    return beside(TITLES[job], WORKER, job, folder, *words, wanted=wanted, holds=cache.lock, say=cache.say)
