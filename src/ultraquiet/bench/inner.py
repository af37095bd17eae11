"""What benches around a bench share: its blocks, whatever it can do, and the record they make."""

import inspect
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench._abstract import Block, Streaming, Tally, limits
from ultraquiet.values import Channel, Record, StateSpace
from ultraquiet.values.channel import at_limits


class Around:
    """What benches around a bench share; they say how it is seen (`seen`), and hand over its runs in blocks."""

    bench: Any

    def seen(self, model: StateSpace) -> StateSpace:
        """Return a linear model of the bench as it is seen through this one."""
        raise NotImplementedError

    def stream(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        *,
        run_index: int | None = None,
    ) -> Iterator[Block]:
        """Yield the run of `run` in blocks; see `Streaming.stream`."""
        raise NotImplementedError

    def __getattr__(self, name: str) -> Any:
        # What else the bench offers is offered too; its linear model as it is seen, and only where it has one. While a
        # bench is copied it has no fields yet.
        if name.startswith("__") or name in getattr(type(self), "__dataclass_fields__", ()):
            raise AttributeError(name)
        found = getattr(self.bench, name)
        return (lambda: self.seen(found())) if name == "linear_model" else found

    def run(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        run_index: int | None = None,
    ) -> Record:
        """Return the record of one run; see `Bench.run`."""
        return recorded(self, self.stream(actuation, disturbance, controller, run_index=run_index))


def blocks_of(
    bench: Any,
    actuation: FloatArray,
    disturbance: FloatArray | None,
    controller: Any | None,
    *,
    run_index: int | None,
    block_samples: int,
    stop: Callable[[], bool] | None,
    ramp_samples: int,
) -> Iterator[Block]:
    """Return a run of a bench in blocks; one that does not stream is run whole and handed over in pieces."""
    if isinstance(bench, Streaming):
        how = {"block_samples": block_samples, "stop": stop, "ramp_samples": ramp_samples}
        return bench.stream(actuation, disturbance, controller, run_index=run_index, **how)
    size = whole("run", "block_samples", block_samples, 1)
    whole("run", "ramp_samples", ramp_samples, 1)
    numbered = {"run_index": run_index} if "run_index" in inspect.signature(bench.run).parameters else {}
    return _pieces(bench.run(actuation, disturbance, controller, **numbered), size, stop)


@contextmanager
def ended(blocks: Iterator[Block]) -> Generator[None]:
    """End a run with a block of code, whatever ends that: an error's traceback may hold an iterator for ever."""
    try:
        yield
    finally:
        getattr(blocks, "close", lambda: None)()


def _pieces(record: Record, size: int, stop: Callable[[], bool] | None) -> Iterator[Block]:
    low, high = limits(record.actuators)
    for start in range(0, record.samples, size):
        if stop is not None and stop():
            return
        u, y = record.inputs[:, start : start + size], record.outputs[:, start : start + size]
        # A record tells no commands that were limited from those that were asked for at the limit.
        limited = np.count_nonzero((u < low[:, None]) | (u > high[:, None]), axis=1)
        yield Block(u, y, limited, at_limits(y, record.sensors))


def recorded(bench: Any, blocks: Iterator[Block]) -> Record:
    """Return the blocks of a whole run as one record."""
    taken, tally = list(blocks), Tally()
    for block in taken:
        tally.take(block)
    command, readings = (np.concatenate([getattr(b, n) for b in taken], axis=1) for n in ("command", "readings"))
    made: Provenance = bench.provenance
    wires: tuple[tuple[Channel, ...], tuple[Channel, ...]] = (bench.actuators, bench.sensors)
    provenance = replace(made, settings={**made.settings, **tally.counts()})
    return Record(command, readings, bench.rate_hz, *wires, provenance)


def named_provenance(name: str, bench: Any, settings: Mapping[str, Any]) -> Provenance:
    """Return the provenance of a bench around another, whose own it holds."""
    inner = getattr(bench, "provenance", None)
    if not isinstance(inner, Provenance):
        return Provenance(name, {**settings, "bench": type(bench).__name__})
    held = {"bench": inner.made_by, "bench_settings": dict(inner.settings)}
    return Provenance(name, {**settings, **held}, inner.seed, inner.parents, inner.versions)
