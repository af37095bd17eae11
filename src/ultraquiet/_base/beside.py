"""Work of a process of its own, its progress shown by this one: threads of Python hold each other up."""

import os
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from threading import Condition, Event, Thread

from ultraquiet._base.progress import Task, task

TICKS = 100  # of the bar
SENTENCE = "say "  # before a sentence, among the words of a process


@contextmanager
def beside(
    title: str,
    module: str,
    *words: str,
    wanted: bool = True,
    holds: int | None = None,
    say: Callable[[str], object] = str,
) -> Generator["Said"]:
    """Run `python -m module words` for the length of a block, where there is a second processor for it.

    Args:
        title: what the progress bar says.
        module: prints its progress as `Ticks` does, and words; it leaves what it makes in files. How it ended is not
            told: who finds nothing there makes it.
        words: its arguments.
        wanted: nothing is run without.
        holds: an open file that the process keeps open too, a lock that it works under.
        say: told the sentences that it tells (`tell`).

    Yields:
        What waits for it, or for a word of it. It is ended with the block.
    """
    process = _started(module, words, holds) if wanted and (os.cpu_count() or 1) > 1 else None
    if process is None:
        yield Said(ended=True)
        return
    with process, task(title, TICKS) as progress:
        said = Said(process=process)
        reader = Thread(target=_follow, args=(process, progress, said, say), daemon=True)
        reader.start()
        try:
            yield said
        finally:
            process.kill()
            reader.join()


class Said:
    """The words that a process has said, and the one that is said to it."""

    def __init__(self, ended: bool = False, process: "subprocess.Popen[str] | None" = None) -> None:
        self._words: set[str] = set()
        self._ended, self._process = ended, process
        self._changed = Condition()

    @property
    def ended(self) -> bool:
        """Whether no more will come."""
        return self._ended

    def begin(self) -> None:
        """Tell a process that makes itself ready beforehand that what it works on is there."""
        if self._process is None or self._process.stdin is None:
            return
        with suppress(OSError):  # it is gone: whoever finds nothing made makes it
            os.write(self._process.stdin.fileno(), b"\n")  # nothing stays behind in a buffer

    def wait(self, word: str | None = None) -> None:
        """Wait until the process has said a word, or has ended; without a word, until it has ended."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or word in self._words)

    def add(self, word: str) -> None:
        """Take note of a word."""
        with self._changed:
            self._words.add(word)
            self._changed.notify_all()

    def end(self) -> None:
        """Take note that no more will come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()


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


def _started(module: str, words: tuple[str, ...], holds: int | None) -> "subprocess.Popen[str] | None":
    command = [sys.executable, "-m", module, *words]
    out, quiet, kept = subprocess.PIPE, subprocess.DEVNULL, () if holds is None else (holds,)
    try:
        # Its input's end tells it that this process is gone.
        return subprocess.Popen(command, stdin=out, stdout=out, stderr=quiet, text=True, pass_fds=kept)
    except OSError:
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
    finally:
        said.end()
