"""Progress bars for whatever computes."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from ultraquiet._base.progress import listening


class Bars:
    """Shows one bar per task; a finished task stays as a line with its time."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def start(self, title: str, total: int) -> int:
        """Show a new bar."""
        return int(self._progress.add_task(title, total=max(total, 1), note=""))

    def advance(self, key: int, steps: int, note: str) -> None:
        """Move a bar and show what is in hand."""
        self._progress.update(self._progress.task_ids[self._index(key)], advance=steps, note=note)

    def finish(self, key: int) -> None:
        """Leave the bar full."""
        row = self._progress.tasks[self._index(key)]
        self._progress.update(row.id, completed=row.total, note="")
        self._progress.stop_task(row.id)

    def _index(self, key: int) -> int:
        return next(i for i, row in enumerate(self._progress.task_ids) if int(row) == key)


@contextmanager
def bars() -> Iterator[Console]:
    """Show progress of everything inside the block on stderr; lines printed to the console stay above the bars."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description:<28}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("[dim]{task.fields[note]}"),
    )
    with Progress(*columns, console=console) as progress, listening(Bars(progress)):
        yield console
