"""Where each measurement of a list stands in a folder: done, broken off, or not started."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ultraquiet._base.errors import BenchError
from ultraquiet.experiments import journal
from ultraquiet.experiments.measure import path_of
from ultraquiet.experiments.plan import Measurement

DONE, ABORTED, NOT_STARTED = "DONE", "ABORTED", "NOT STARTED"
Standing = Literal["DONE", "ABORTED", "NOT STARTED"]


@dataclass(frozen=True)
class State:
    """Where one measurement stands, and what is left of it: the newest file's name, empty when there is none."""

    name: str
    status: Standing
    file: str


class StoppedError(BenchError):
    """A list that did not run to its end; `.states` says where each measurement stands, `.asked` who ended it.

    Every finished record is safe, and what was measured of the one that was broken off is kept as `NAME.partial.h5`.
    """

    def __init__(self, sentence: str, states: Sequence[State], asked: bool) -> None:
        self.states = tuple(states)
        self.asked = asked
        counts = ", ".join(f"{sum(s.status == kind for s in states)} {kind.lower()}" for kind in _KINDS)
        super().__init__(f"experiment: {sentence}; {counts}.")


_KINDS: tuple[Standing, ...] = (DONE, ABORTED, NOT_STARTED)


def states(measurements: Sequence[Measurement], folder: Path) -> tuple[State, ...]:
    """Return where the measurements of a list stand in a folder, in the order of the list."""
    begun = journal.begun(folder)
    return tuple(_state(m.name, folder, m.name in begun) for m in measurements)


def _state(name: str, folder: Path, begun: bool) -> State:
    if path_of(folder, name).exists():
        return State(name, DONE, path_of(folder, name).name)
    parts = sorted(folder.glob(f"{name}.partial*.h5"), key=lambda path: path.stat().st_mtime_ns)
    if parts or begun:
        return State(name, ABORTED, parts[-1].name if parts else "")
    return State(name, NOT_STARTED, "")
