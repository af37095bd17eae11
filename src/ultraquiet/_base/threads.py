"""Threads: one for the linear-algebra libraries inside small solvers, all processors for work that holds no lock."""

import os
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

from ultraquiet._base.progress import task

P = ParamSpec("P")
R = TypeVar("R")
Item = TypeVar("Item", bound=Hashable)


def in_threads(
    title: str, work: Callable[[Item], R], items: Sequence[Item], workers: int | None = None
) -> dict[Item, R]:
    """Run `work` on every item in threads (the kernels hold no lock), showing progress; the first error is raised.

    Args:
        title: what the progress bar says.
        work: called once an item; what has not begun when one fails is not begun any more.
        items: what to work on, each once.
        workers: threads; as many as processors when absent.

    Returns:
        The result of each item, in the order in which they were done.

    >>> sorted(in_threads("squares", lambda x: x * x, [1, 2, 3]).items())
    [(1, 1), (2, 4), (3, 9)]
    """
    results: dict[Item, R] = {}
    with task(title, len(items)) as progress, ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        futures = {pool.submit(work, item): item for item in items}
        try:
            for future in as_completed(futures):
                results[futures[future]] = future.result()
                progress.advance(note=str(futures[future]))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def single_threaded(solver: Callable[P, R]) -> Callable[P, R]:
    """Run a function with one BLAS thread.

    Matrices of a hundred states are too small to share: on two cores, threads inside each product made the same fit
    twice as slow, and twenty times when other work ran beside it.

    >>> single_threaded(abs)(-3)
    3
    """

    @wraps(solver)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        # It ships no types; as a plain module it is what it says.
        limits = import_module("threadpoolctl").threadpool_limits
        with limits(limits=1, user_api="blas"):
            return solver(*args, **kwargs)

    return alone
