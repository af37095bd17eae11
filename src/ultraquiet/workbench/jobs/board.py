"""All work of a study: a lane for what makes items, one for what only looks at them, and what was said of it."""

from collections import deque
from collections.abc import Callable
from typing import Any

from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.jobs.lane import Lane, WorkItem

SHOWN = 50
LONG = ("limit",)  # looks of many seconds: a process of their own, so that no other waits for them


class Jobs:
    """The work of one session.

    Args:
        session: whose items are made.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.version = 0
        self.recent: deque[WorkItem] = deque(maxlen=SHOWN)
        self.looked: deque[WorkItem] = deque(maxlen=SHOWN)
        self._lanes = {name: Lane(session.folder, self._told) for name in ("make", "look", "long", "bench")}

    def warm(self) -> None:
        """Start the processes before there is work."""
        for name in ("make", "look"):
            self._lanes[name].warm()

    def make(self, board: str, name: str, then: Callable[[WorkItem], object] | None = None) -> WorkItem:
        """Make an item, and tell the session when it is there."""

        def done(job: WorkItem) -> None:
            if job.status == "done":
                self.session.made(board, name)
            if then is not None:
                then(job)

        words = {"board": board, "name": name}
        return self.submit(WorkItem("make", f"{self.session.state[board][name]['op']} {name}", {}, words, done))

    def look(self, task: str, title: str, then: Callable[[WorkItem], object] | None = None, **words: Any) -> WorkItem:
        """Compute something to look at; nothing is kept of it."""
        return self.submit(WorkItem(task, title, {}, words, then), "long" if task in LONG else "look")

    def on_bench(
        self, task: str, title: str, then: Callable[[WorkItem], object] | None = None, **words: Any
    ) -> WorkItem:
        """Do something with the bench, in a process of its own."""
        return self.submit(WorkItem(task, title, {}, words, then), "bench")

    def submit(self, job: WorkItem, lane: str = "make") -> WorkItem:
        """Take a job with the boards as they stand."""
        job.state = dict(self.session.state)
        (self.looked if lane in ("look", "long") else self.recent).append(job)
        return self._lanes[lane].submit(job)

    def cancel(self, job: WorkItem | None = None) -> None:
        """End a job, or all work of the study."""
        for each in [job] if job is not None else [one for one in self.recent if not one.over]:
            for lane in self._lanes.values():
                lane.cancel(each)

    def pid(self, lane: str = "make") -> int | None:
        """Return the process of a lane."""
        return self._lanes[lane].pid

    def close(self) -> None:
        """End all processes."""
        for lane in self._lanes.values():
            lane.close()

    def _told(self) -> None:
        self.version += 1
