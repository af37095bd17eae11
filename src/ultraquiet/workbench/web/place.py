"""What all pages share: the session, its work, and the frames that browsers fetch."""

from collections.abc import Callable
from dataclasses import dataclass, field

from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.jobs.board import Jobs
from ultraquiet.workbench.web.frames import FrameStore


@dataclass(eq=False)
class ServedStudy:
    """One study that is served; `stops` end whatever moves on a bench, besides all work."""

    session: Session
    jobs: Jobs
    frames: FrameStore
    stops: list[Callable[[], object]] = field(default_factory=list)
    stopped: int = 0

    def stop(self) -> None:
        """End everything that runs, at once; what was finished is kept."""
        self.stopped += 1
        for each in list(self.stops):
            each()
        self.jobs.cancel()

    @property
    def version(self) -> tuple[int, int, int]:
        """What changes with every change of the study, of its work, and with every stop."""
        return self.session.version, self.jobs.version, self.stopped
