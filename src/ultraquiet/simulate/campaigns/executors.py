"""Where the cases of a campaign run: on the cores of this machine, or on a Dask cluster; the same call."""

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, cast

import joblib

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.simulate.campaigns.drawing import WHO

LOCAL = "local"
Work = Callable[[int], dict[str, Any]]


def results(work: Work, cases: Sequence[int], workers: int | None, cluster: str | None) -> Iterator[dict[str, Any]]:
    """Yield the results of all cases, each as soon as it is there, in any order.

    Args:
        work: called with the number of a case; it and what it holds travel to where they run.
        cases: numbers.
        workers: processes; as many as cores when absent.
        cluster: None for this machine's cores; "local" for a Dask cluster on this machine, or a scheduler's address.

    Raises:
        InputError: less than one worker.
        ToolError: the package `distributed` is missing, or there is no scheduler.
    """
    many = os.cpu_count() or 1 if workers is None else whole(WHO, "workers", workers, 1)
    if not cases:
        return
    if cluster is None and many == 1:
        yield from map(work, cases)
        return
    with _backend(cluster, many) as how:
        run = joblib.Parallel(return_as="generator_unordered", pre_dispatch="4*n_jobs", **how)
        yield from cast("Iterator[dict[str, Any]]", run(joblib.delayed(work)(case) for case in cases))


@contextmanager
def _backend(cluster: str | None, workers: int) -> Generator[dict[str, Any]]:
    if cluster is None:
        yield {"n_jobs": workers, "backend": "loky"}
        return
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise ToolError(
            f"{WHO}: a cluster needs the package 'distributed'; install ultraquiet with its extra 'cluster'."
        ) from None
    where: dict[str, Any] = {"address": cluster}
    if cluster == LOCAL:
        where = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
    try:
        client = distributed.Client(**where)
    except (OSError, ValueError) as error:
        raise ToolError(f"{WHO}: there is no Dask scheduler at '{cluster}' ({error}).") from error
    with client, joblib.parallel_config(backend="dask", wait_for_workers_timeout=60):
        yield {"n_jobs": -1}


def require_portable(value: Any) -> None:
    """Refuse what cannot travel to another process; classes of a user's own file travel with their source.

    Raises:
        InputError: it holds what cannot be sent, an open line to hardware for instance.
    """
    try:
        import_module("cloudpickle").dumps(value)  # what joblib and Dask send with
    except Exception as error:
        raise InputError(
            f"{WHO}: the bench, a {type(value).__name__}, cannot be sent to other processes ({error}); take one worker."
        ) from error
