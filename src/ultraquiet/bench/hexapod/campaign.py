"""Many runs of one experiment, each with its own seed, on all processors."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.values import Record, StateSpace

if TYPE_CHECKING:
    from ultraquiet.bench.hexapod.unit import Hexapod


def campaign(
    bench: "Hexapod",
    seeds: Sequence[int],
    actuation: ArrayLike,
    disturbance: ArrayLike | None,
    controller: Any | None,
    own_units: bool,
) -> tuple[Record, ...]:
    """Return the first run of the bench for each seed; see `Hexapod.campaign`.

    The compiled loop lets go of Python's lock, so threads share the processors and the unit's matrices. A controller
    that is stepped holds the lock and has one state: its runs follow one another.
    """
    if not len(seeds):
        raise InputError("Hexapod.campaign: 'seeds' must name at least one run, got none.")
    if own_units and not bench.spread:
        raise InputError("Hexapod.campaign: units of their own need a 'spread' above zero, or all are the same.")
    checked = [whole("Hexapod.campaign", "seeds", seed, 0) for seed in seeds]

    def run(seed: int) -> Record:
        one = replace(bench, seed=seed, unit_seed=seed if own_units else bench.unit_seed)
        return one.run(actuation, disturbance, controller, run_index=0)

    alone = controller is not None and not isinstance(controller, StateSpace)
    workers = 1 if alone else min(len(checked), os.cpu_count() or 1)
    with task("campaign", len(checked)) as progress, ThreadPoolExecutor(workers) as pool:
        records: list[Record] = []
        for record in pool.map(run, checked):
            records.append(record)
            progress.advance()
    return tuple(records)
