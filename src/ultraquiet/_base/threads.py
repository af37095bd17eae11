"""Hold the linear-algebra libraries to one thread inside small solvers."""

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


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
