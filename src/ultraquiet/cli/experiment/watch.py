"""What a running list looks like: a live table on a terminal, plain lines in a pipe."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ultraquiet._base.shown.line import counted
from ultraquiet.cli.output.screen import harmless
from ultraquiet.experiments import Course, Levels, Onlooker
from ultraquiet.experiments.plan import Measurement

REFRESH_HZ = 8.0  # faster than anybody reads, slow enough to cost nothing
LINE_EVERY_S = 10.0  # how often a long measurement says in a pipe that it goes on
BAR_CELLS = 20
LOUD = 0.9  # of the range: where clipping is near


class Steady(Console):
    """A console that falls silent when nobody reads any more; that is no reason to stop a bench."""

    def on_broken_pipe(self) -> None:
        """Say nothing further; rich itself would end the program."""
        self.quiet = True


class Watcher(Onlooker):
    """Keeps what every display shows: which measurement, how many of how many, how long still."""

    def __init__(self, console: Console, stopping: Callable[[], bool]) -> None:
        self.console, self.stopping = console, stopping
        self.warned = 0
        self._total = self._number = 0
        self._course = Course(0.0, False)

    def begins(self, steps: Sequence[Measurement], finished: Sequence[str], course: Course) -> None:
        """Say how much there is to do, and what is there already."""
        self._total, self._course = len(steps), course
        if finished:
            self.say(f"{counted(len(finished), 'record is', 'records are')} there already and kept; {len(steps)} to go")

    def measures(self, step: Measurement, levels: Levels) -> None:
        """Count."""
        self._number += 1

    def ends(self, step: Measurement, levels: Levels, status: str, warnings: Sequence[str]) -> None:
        """Leave one line, and one for each warning."""
        self.say(f"{self._place} {step.name:<16} {status:<8} {loudness(levels)}")
        self.warned += len(warnings)
        for warning in warnings:
            self.say(f"  warning: {warning}", "yellow")

    def lowers(self, sentence: str) -> None:
        """Say it."""
        self.say(sentence)

    def waits(self, seconds: float, skipped: bool) -> None:
        """Say for how long, or that there is no need to."""
        self.say(f"wait of {seconds:g} s" + (" skipped: a simulated bench is at rest" if skipped else ""))

    def reads(self, name: str, temperature_c: float) -> None:
        """Say the temperature."""
        self.say(f"temperature '{name}': {temperature_c:.2f} degrees Celsius")

    def say(self, line: str, style: str = "") -> None:
        """Leave a line that stays."""
        with suppress(OSError):  # a terminal that was closed
            self.console.print(Text(harmless(line), style), soft_wrap=True)

    @property
    def _place(self) -> str:
        width = len(str(self._total))
        return f"[{self._number:>{width}}/{self._total}]"

    @property
    def _left(self) -> str:
        seconds = round(self._course.left_s)
        return f"{seconds // 60}:{seconds % 60:02d} left"


class PlainLines(Watcher):
    """For pipes, files and dull terminals."""

    _spoke = 0.0

    def measures(self, step: Measurement, levels: Levels) -> None:
        """Begin to count the seconds of silence."""
        super().measures(step, levels)
        self._spoke = time.monotonic()

    def advances(self, step: Measurement, levels: Levels) -> None:
        """Say now and then that a long measurement goes on."""
        if time.monotonic() - self._spoke < LINE_EVERY_S:
            return
        self._spoke = time.monotonic()
        percent = 100 * levels.samples // step.samples
        self.say(f"{self._place} {step.name:<16} {percent:3} %    {loudness(levels)}, {self._left}")


class Board(Watcher):
    """For terminals: a row for each sensor, renewed while it is being measured."""

    def __init__(self, console: Console, stopping: Callable[[], bool], live: Live) -> None:
        super().__init__(console, stopping)
        self._live = live
        self._drawn = 0.0

    def advances(self, step: Measurement, levels: Levels) -> None:
        """Draw, but not more often than anybody sees."""
        if time.monotonic() - self._drawn >= 1.0 / REFRESH_HZ:
            self._drawn = time.monotonic()
            self._draw(self._drawing(step, levels))

    def ends(self, step: Measurement, levels: Levels, status: str, warnings: Sequence[str]) -> None:
        """Leave the lines above, and clear the board."""
        super().ends(step, levels, status, warnings)
        self._draw(Text(f"{self._place} {step.name} {status}, {self._left}", "dim"))

    def _draw(self, board: RenderableType) -> None:
        with suppress(OSError):
            self._live.update(board, refresh=True)

    def _drawing(self, step: Measurement, levels: Levels) -> RenderableType:
        percent = 100 * levels.samples // step.samples
        head = f"{self._place} {step.name}: {percent} %, {self._left}, frames too late: {levels.overruns}"
        if self.stopping():
            head += "; stopping, the bench goes to zero"
        return Group(Text(head, "bold"), board(levels))


def board(levels: Levels) -> Table:
    """Return the levels of all sensors as a table."""
    table = Table("sensor", "RMS now", "RMS", "peak", "of range", "", "clipped", box=None, header_style="dim")
    for k, sensor in enumerate(levels.sensors):
        share = float(levels.share[k])
        bounded = sensor.low > -float("inf") or sensor.high < float("inf")
        colour = "red" if levels.clipped[k] else "yellow" if share > LOUD else "green"
        bar = Text("#" * round(BAR_CELLS * min(share, 1.0)), colour)
        numbers = (levels.last_rms[k], levels.rms[k], levels.peak[k])
        volts = (Text(sensor.in_unit(value, 3)) for value in numbers)
        table.add_row(
            Text(sensor.name), *volts, f"{100 * share:.0f} %" if bounded else "-", bar, str(levels.clipped[k])
        )
    return table


def loudness(levels: Levels) -> str:
    """Return the loudest sensor and the counts in one line."""
    loudest = int(levels.peak.argmax())
    sensor, share = levels.sensors[loudest], levels.share[loudest]
    of_range = f" ({100 * share:.3g} % of range)" if share else ""
    level = f"{sensor.name}: RMS {sensor.in_unit(levels.rms[loudest], 3)}, peak {levels.peak[loudest]:.3g}{of_range}"
    return f"{counted(levels.samples, 'sample')}, {level}, clipped {levels.clipped.sum()}, late {levels.overruns}"


@contextmanager
def watching(stopping: Callable[[], bool], quiet: bool = False) -> Iterator[Watcher]:
    """Show a running list on stderr for the length of a block, or nothing."""
    console = Steady(stderr=True, highlight=False, quiet=quiet)
    if quiet or not console.is_terminal:
        yield PlainLines(console, stopping)
        return
    with Live(Text(""), console=console, auto_refresh=False, transient=True) as live:
        yield Board(console, stopping, live)
