"""Threads: one for the linear-algebra libraries inside small solvers, all processors for work that holds no lock."""

import os
import sys
from collections import deque
from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import Context, copy_context
from functools import lru_cache, wraps
from importlib import import_module
from threading import Event, Lock
from typing import Any, ParamSpec, TypeVar

from ultraquiet._base.constraints import whole
from ultraquiet._base.progress import interrupts, task, wanted_until

P = ParamSpec("P")
R = TypeVar("R")
Item = TypeVar("Item", bound=Hashable)
GLANCE_S = 0.5


def in_threads(
    title: str, work: Callable[[Item], R], items: Sequence[Item], workers: int | None = None, bars: bool = False
) -> dict[Item, R]:
    """Run `work` on every item in threads (the kernels hold no lock), showing progress; the first error is raised.

    Each runs with one BLAS thread: threads inside threads wait for one another, and the sums hang on their number.
    Where this thread is interrupted the others end at their next step of progress, or block of samples on a bench.

    Args:
        title: what the progress bar says.
        work: called once an item; what has not begun when one fails is not begun any more.
        items: what to work on, each once.
        workers: threads; as many as processors when absent.
        bars: show the progress of what the items do, each with a bar of its own.

    Returns:
        The result of each item, in the order in which they were done.

    >>> sorted(in_threads("squares", lambda x: x * x, [1, 2, 3]).items())
    [(1, 1), (2, 4), (3, 9)]
    """
    if workers is not None:
        whole(title, "workers", workers, 0)
    results: dict[Item, R] = {}
    interrupt = Event()
    ends = (*interrupts(), interrupt)

    def until_interrupted(item: Item) -> R:
        with wanted_until(*ends):
            return work(item)

    pool = ThreadPoolExecutor(workers or os.cpu_count())
    futures: dict[Future[R], Item] = {}
    with one_blas_thread(), task(title, len(items)) as progress, _ended_with(pool, futures, interrupt):
        begin = [(copy_context() if bars else Context()).run for _ in items]
        for run, item in zip(begin, items, strict=True):
            futures[pool.submit(run, until_interrupted, item)] = item
        for future in _as_completed(futures):
            results[futures[future]] = future.result()
            progress.advance(note=str(futures[future]))
    return results


def _as_completed(futures: Iterable[Future[R]]) -> Iterator[Future[R]]:
    """Yield futures as they are done; looks up now and then, for a signal may come just before a wait without end."""
    pending = set(futures)
    while pending:
        done, pending = wait(pending, GLANCE_S, FIRST_COMPLETED)
        yield from done


@contextmanager
def _ended_with(pool: ThreadPoolExecutor, begun: Collection[Future[Any]], interrupt: Event) -> Generator[None]:
    """Wait after a block for what it began in a pool; where block or wait are interrupted, so is all that goes on.

    After an error what has not begun does not begin any more. Interrupted again, nobody waits any longer.
    """

    def ended() -> None:
        pool.shutdown(wait=False, cancel_futures=True)
        # not by joining: a thread of which that was interrupted is taken for one that has ended
        deque(_as_completed([future for future in begun if not future.cancelled()]), maxlen=0)

    try:
        try:
            yield
        except Exception:
            ended()
            raise
    except Exception:
        raise
    except BaseException:
        interrupt.set()
        ended()
        raise
    finally:
        pool.shutdown()


def single_threaded(solver: Callable[P, R]) -> Callable[P, R]:
    """Run a function with one BLAS thread.

    Matrices of a hundred states are too small to share: on two cores, threads inside each product made the same fit
    twice as slow, and twenty times when other work ran beside it.

    >>> single_threaded(abs)(-3)
    3
    """

    @wraps(solver)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_blas_thread():
            return solver(*args, **kwargs)

    return alone


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Return a block in which BLAS uses one thread.

    Blocks may lie in one another and beside one another in several threads: the first to begin finds out how many
    threads there were, and the last to end gives them back.
    """
    _ONE.begin()
    try:
        yield
    finally:
        _ONE.end()


class _OneThread:
    """How many blocks hold the libraries to one thread, and how many threads each of them had before the first."""

    def __init__(self) -> None:
        self._lock, self._blocks = Lock(), 0
        self._before: dict[str, tuple[Any, int]] = {}

    def begin(self) -> None:
        """Hold every library that is loaded to one thread."""
        libraries = _libraries("scipy.linalg" in sys.modules)
        with self._lock:
            self._blocks += 1
            for library in libraries:
                if library.filepath not in self._before:
                    self._before[library.filepath] = library, library.num_threads
                    library.set_num_threads(1)

    def end(self) -> None:
        """Let go when no other block is left."""
        with self._lock:
            self._blocks -= 1
            if not self._blocks:
                for library, threads in self._before.values():
                    library.set_num_threads(threads)
                self._before.clear()


_ONE = _OneThread()


@lru_cache
def _libraries(scipy: bool) -> list[Any]:
    """Return the libraries of linear algebra; looking for them takes longer than a small design.

    `scipy` is whether it is there already, for it brings one of its own: once it comes, they are looked for again.
    """
    # It ships no types; as a plain module it is what it says.
    found = import_module("threadpoolctl").ThreadpoolController().lib_controllers
    return [library for library in found if library.user_api == "blas"]
