"""Work of a process of its own, its progress shown by this one: threads of Python hold each other up."""

import os
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from threading import Condition, Event, Thread

from ultraquiet._base.progress import Task, require_wanted, task
from ultraquiet._base.threads import GLANCE_S

TICKS = 100  # of the bar
SENTENCE = "say "  # before a sentence, among the words of a process
BYTES = 4  # of a number in a pipe


@contextmanager
def beside(
    title: str,
    module: str,
    *words: str,
    wanted: bool = True,
    processes: int = 1,
    holds: Sequence[int] = (),
    say: Callable[[str], object] = str,
) -> Generator["Said"]:
    """Run `python -m module words` for the length of a block, where there is a second processor for it.

    Args:
        title: what the progress bar says.
        module: prints its progress as `Ticks` does, and words; it leaves what it makes in files. How it ended is not
            told: who finds nothing there makes it.
        words: its arguments.
        wanted: nothing is run without.
        processes: how many of the same; they share their work by `numbered`. Where one fails the others are ended too.
        holds: open files that the processes keep open too: a lock that they work under, numbers that they take.
        say: told the sentences that they tell (`tell`).

    Yields:
        What waits for them, or for a word of one of them. They are ended with the block.
    """
    wanted_processes = processes if wanted and (os.cpu_count() or 1) > 1 else 0
    started = [each for _ in range(wanted_processes) if (each := _started(module, words, holds)) is not None]
    if not started:
        yield Said()
        return
    with ExitStack() as stack, task(title, TICKS) as progress:
        for each in started:
            stack.enter_context(each)
        said = Said(started)
        readers = [Thread(target=_follow, args=(each, progress, said, say), daemon=True) for each in started]
        for reader in readers:
            reader.start()
        try:
            yield said
        finally:
            said.kill()
            for reader in readers:
                reader.join()


class Said:
    """The words that processes have said, and the one that is said to them; of none, no word will come."""

    def __init__(self, processes: "Sequence[subprocess.Popen[str]]" = ()) -> None:
        self._words: set[str] = set()
        self._processes, self._running = processes, len(processes)
        self._changed = Condition()

    @property
    def ended(self) -> bool:
        """Whether no more will come."""
        return self._running == 0

    def begin(self) -> None:
        """Tell processes that make themselves ready beforehand that what they work on is there."""
        for process in self._processes:
            assert process.stdin is not None
            with suppress(OSError):  # it is gone: whoever finds nothing made makes it
                os.write(process.stdin.fileno(), b"\n")  # nothing stays behind in a buffer

    def wait(self, word: str | None = None) -> None:
        """Wait until a process has said a word, or all have ended; without a word, until all have ended.

        Raises:
            KeyboardInterrupt: it is wanted no more.
        """
        with self._changed:
            while not self._changed.wait_for(lambda: self.ended or word in self._words, GLANCE_S):
                require_wanted()

    def add(self, word: str) -> None:
        """Take note of a word."""
        with self._changed:
            self._words.add(word)
            self._changed.notify_all()

    def end(self) -> None:
        """Take note that one of them says no more."""
        with self._changed:
            self._running -= 1
            self._changed.notify_all()

    def kill(self) -> None:
        """End all of them."""
        for process in self._processes:
            process.kill()


@contextmanager
def numbered(count: int) -> Generator[int]:
    """Yield an open file from which processes that hold it take the numbers below `count` in order, each once."""
    taken, given = os.pipe()
    try:
        with open(given, "wb") as numbers:
            numbers.write(b"".join(number.to_bytes(BYTES) for number in range(count)))
        yield taken
    finally:
        os.close(taken)


def turns(file: int) -> Iterator[int]:
    """Yield the numbers that are this process's to take."""
    while number := os.read(file, BYTES):
        yield int.from_bytes(number)


def tell(sentence: str) -> None:
    """Tell the process that began this one a sentence."""
    print(f"{SENTENCE}{sentence}", flush=True)


class Ticks:
    """A listener that prints how many hundredths of the largest task were done since the last line."""

    def __init__(self) -> None:
        self._total, self._done, self._told = 1, 0, 0

    def start(self, title: str, total: int) -> int:
        """Begin a task."""
        self._total = max(self._total, total)
        return 0

    def advance(self, key: int, steps: int, note: str) -> None:
        """Move on."""
        self._done += steps
        share = min(TICKS, TICKS * self._done // self._total)
        if share > self._told:
            print(share - self._told, flush=True)
            self._told = share

    def finish(self, key: int) -> None:
        """End a task."""


def end_with_parent() -> Event:
    """Let this process, run by `beside`, end as soon as the one that began it is gone, killed or not.

    Returns:
        What is set when that one says `Said.begin`.
    """
    begun = Event()

    def watch() -> None:
        while os.read(0, 1):  # not through `sys.stdin`, whose lock would hold up the interpreter's own end
            begun.set()
        os._exit(1)

    Thread(target=watch, daemon=True).start()
    return begun


def _started(module: str, words: tuple[str, ...], holds: Sequence[int]) -> "subprocess.Popen[str] | None":
    command = [sys.executable, "-m", module, *words]
    out, quiet = subprocess.PIPE, subprocess.DEVNULL
    try:
        # Its input's end tells it that this process is gone.
        return subprocess.Popen(command, stdin=out, stdout=out, stderr=quiet, text=True, pass_fds=holds)
    except (OSError, ValueError):  # there are systems on which no file is handed on
        return None


def _follow(process: "subprocess.Popen[str]", progress: Task, said: Said, say: Callable[[str], object]) -> None:
    assert process.stdout is not None
    try:
        for line in process.stdout:
            word = line.strip()
            if word.isdecimal():
                progress.advance(int(word))
            elif word.startswith(SENTENCE):
                say(word.removeprefix(SENTENCE))
            else:
                said.add(word)
        if process.wait():
            said.kill()  # nobody waits for what a process that failed had taken, and nothing is made twice
    finally:
        said.end()
