"""What the process that computes can be asked for, by name."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ultraquiet.workbench.engine.making import work
from ultraquiet.workbench.engine.making.imports import looked_over
from ultraquiet.workbench.jobs import bench_work, looks


def _make(folder: Path, state: Mapping[str, Any], board: str, name: str) -> dict[str, Any]:
    return {"key": work.make(folder, dict(state), board, name, shared=True).key}


def _look_over(folder: Path, state: Mapping[str, Any], file: str, rate_hz: float | None = None) -> dict[str, Any]:
    found = looked_over(folder, file, rate_hz)
    channels = [
        {"name": c.name, "unit": c.unit, "role": c.role, "samples": c.samples, "rms": c.rms, "peak": c.peak}
        | {"clipped": c.clipped, "missing": c.missing}
        for c in found.channels
    ]
    head = {"file": file, "format": found.format, "size": found.size, "rate_hz": found.rate_hz}
    clock = {"clock": found.clock, "clock_hz": found.clock_hz}
    return {**head, **clock, "duration_s": found.duration_s, "notes": list(found.notes), "channels": channels}


TASKS: dict[str, Callable[..., Any]] = {
    "make": _make,
    "look over": _look_over,
    "trace": looks.trace,
    "response": looks.response,
    "density": looks.density,
    "judge": looks.judge,
    "confidence": looks.confidence,
    "orders": looks.orders,
    "modes": looks.modes,
    "limit": looks.limit,
    "describe": bench_work.described,
    "measure": bench_work.measured,
    "live": bench_work.live,
    "close": bench_work.closed,
    "run": bench_work.whole,
}
