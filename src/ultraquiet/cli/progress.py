"""Progress bars for whatever computes."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from ultraquiet._base.progress import listening
from ultraquiet.cli.output.screen import screen


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
    """Show progress of everything inside the block on stderr; lines printed to the console stay above the bars.

    Bars are for a terminal; a pipe gets the lines alone, and nothing where silence was asked for.
    """
    console = Console(stderr=True, quiet=screen().quiet, markup=False, highlight=False, soft_wrap=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description:<28}", markup=False),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}", style="dim", markup=False),
    )
    disable = not console.is_terminal or screen().quiet
    with Progress(*columns, console=console, disable=disable) as progress, listening(Bars(progress)):
        yield console
