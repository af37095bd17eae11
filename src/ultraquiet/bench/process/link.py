"""Lines of text to and from a plant in another process, over its standard input and output or over TCP."""

import os
import select
import signal
import subprocess
import time
from collections import deque
from contextlib import suppress

from ultraquiet._base.errors import BenchError, InputError, signal_name
from ultraquiet._base.shown.one_line import printable
from ultraquiet.files import reason

CHUNK_BYTES = 1 << 16
LONGEST_LINE_BYTES = 1 << 20  # 40 000 numbers: more than any plant has channels, so it is no answer but rubbish
LAST_WORDS = 300  # characters of the plant's error output that a sentence quotes
GRACE_S = 1.0  # how long a plant may take to end by itself, then to obey SIGTERM
CONNECT_PAUSE_S = 0.05
PAUSE_S = 0.0005
LONGEST_WAIT_S = 3600.0  # the system's own clocks take no time without end; who waits looks again


class Deadline:
    """When one answer must be there, however many remarks come before it."""

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s, self.asides = timeout_s, 0
        self._end = time.monotonic() + timeout_s

    def left_s(self) -> float:
        """Return the time that is left, an hour at most; negative afterwards."""
        return min(self._end - time.monotonic(), LONGEST_WAIT_S)

    def remarks(self) -> str:
        """Return what it said instead, as a part of a sentence."""
        return f" but {self.asides} remarks" if self.asides else ""


class Link:
    """Two file descriptors that carry lines both ways; never blocks longer than asked, whatever the plant does.

    `where` says in every error what was going on, as in "at sample 17".
    """

    def __init__(self, name: str, reads: int, writes: int) -> None:
        self.name, self.where = name, "in the handshake"
        self._reads, self._writes = reads, writes
        self._lines: deque[bytes] = deque()
        self._rest, self._unsent = b"", b""

    def send(self, text: str) -> None:
        """Send text, lines with their ends; what the plant does not take yet goes out while `line` waits."""
        self._unsent += text.encode()
        self._push()

    def waiting(self) -> list[str]:
        """Return the lines that have come and were not asked for yet."""
        return [line.decode(errors="replace") for line in self._lines]

    def line(self, deadline: "Deadline") -> str:
        """Return the next line without its end.

        Raises:
            BenchError: no answer came before the deadline, the plant has ended, or what came is no line.
        """
        # A plant that floods always has a line ready: the clock runs all the same.
        if not self._lines or deadline.left_s() <= 0.0:
            self._pull(deadline)
        return self._lines.popleft().decode(errors="replace").rstrip("\r")

    def close(self) -> None:
        """End the connection."""
        raise NotImplementedError

    def ending(self) -> str:
        """Return how the plant ended, as the end of a sentence."""
        raise NotImplementedError

    def _give(self, data: bytes) -> int:
        raise NotImplementedError

    def _take(self, most: int) -> bytes:
        raise NotImplementedError

    def _push(self) -> None:
        try:
            while self._unsent:
                self._unsent = self._unsent[self._give(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self._unsent = b""  # whoever ended may have said why: what it said is still to be read

    def _asides(self) -> list[int]:
        """Return what else the plant may speak on, which must not fill up."""
        return []

    def _overhear(self) -> None:
        raise NotImplementedError

    def _pull(self, deadline: "Deadline") -> None:
        while True:
            if deadline.left_s() <= 0.0:
                raise BenchError(
                    f"Process: {self.where} the plant '{self.name}' said nothing{deadline.remarks()} for "
                    f"{deadline.timeout_s:g} s and was given up; allow it more time if it needs that."
                )
            if self._lines:
                return
            asides = self._asides()
            ready, free = stirring([self._reads, *asides], [self._writes] if self._unsent else [], deadline.left_s())
            if free:
                self._push()
            if self._reads in ready:
                self._receive()
            if any(aside in ready for aside in asides):
                self._overhear()

    def _receive(self) -> None:
        try:
            received = self._take(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if not received:
            raise BenchError(f"Process: {self.where} the plant '{self.name}' {self.ending()}.")
        *lines, self._rest = (self._rest + received).split(b"\n")
        self._lines.extend(lines)
        if len(self._rest) > LONGEST_LINE_BYTES:
            raise BenchError(
                f"Process: {self.where} the plant '{self.name}' sent {len(self._rest)} bytes without an end of line, "
                f"beginning with {self._rest[:40]!r}; that is no answer."
            )


def stirring(reads: list[int], writes: list[int], most_s: float) -> tuple[list[int], list[int]]:
    """Return which descriptors have something to read, or an end, and which take something, within a time."""
    if not hasattr(select, "poll"):  # Windows
        ready, free, _ = select.select(reads, writes, [], most_s)
        return ready, free
    # A driver may hold more than the 1024 descriptors that `select` can count.
    asked = dict.fromkeys(reads, select.POLLIN)
    for each in writes:
        asked[each] = asked.get(each, 0) | select.POLLOUT
    poll = select.poll()
    for each, events in asked.items():
        poll.register(each, events)
    found = poll.poll(1000.0 * max(most_s, 0.0))
    ready = [each for each, events in found if each in reads and events & ~select.POLLOUT]
    return ready, [each for each, events in found if each in writes and events & ~select.POLLIN]


class Child(Link):
    """A plant that is started here, in a session of its own: Ctrl-C reaches the driver alone, which then ends it."""

    def __init__(self, command: tuple[str, ...]) -> None:
        if os.name != "posix":  # pipes cannot be waited for elsewhere
            raise InputError("Process: 'command' needs Linux or macOS; give 'port' and start the plant yourself.")
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise BenchError(f"Process: the plant '{command[0]}' cannot be started ({reason(error)}).") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._words, self._overheard = b"", self._process.stderr.fileno()
        os.set_blocking(self._overheard, False)
        reads, writes = self._process.stdout.fileno(), self._process.stdin.fileno()
        os.set_blocking(reads, False)
        os.set_blocking(writes, False)
        super().__init__(os.path.basename(command[0]), reads, writes)

    def _give(self, data: bytes) -> int:
        return os.write(self._writes, data)

    def _take(self, most: int) -> bytes:
        return os.read(self._reads, most)

    def _asides(self) -> list[int]:
        return [self._overheard] if self._overheard >= 0 else []

    def _overhear(self) -> None:
        """Take what it says on its error output, of which the end is kept: it may talk for ever."""
        while self._overheard >= 0:
            try:
                said = os.read(self._overheard, CHUNK_BYTES)
            except BlockingIOError:
                return
            except OSError:
                said = b""
            self._words = (self._words + said)[-4 * LAST_WORDS :]
            if not said:
                self._overheard = -1  # closed, and no longer asked for
            if len(said) < CHUNK_BYTES:
                return

    def close(self) -> None:
        """Close its input, which asks it to end; what does not end within a grace is killed. No zombie stays."""
        process = self._process
        self._overheard = -1
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
        for order in (None, signal.SIGTERM, signal.SIGKILL):
            if order is not None:
                self._order(order)
            if self._code(GRACE_S) is not None:
                break
        # Its number is its own until it has been waited for: nobody else's session can be meant.
        if process.returncode is None:
            self._order(signal.SIGKILL)
        process.wait()

    def _order(self, order: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, order)

    def _code(self, timeout_s: float) -> int | None:
        """Return the exit code, negative for a signal, of a plant that has ended, and leave it to be waited for."""
        end, pause_s = time.monotonic() + timeout_s, PAUSE_S
        while self._process.returncode is None:
            self._overhear()
            try:
                found = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:  # somebody else has waited for it
                return self._process.wait()
            if found is not None:
                return found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
            if time.monotonic() >= end:
                return None
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, CONNECT_PAUSE_S)
        return self._process.returncode

    def ending(self) -> str:
        """Return its exit code or signal and its last words."""
        code = self._code(GRACE_S)
        self._overhear()
        if code is None:
            return "closed its output" + self._last_words()
        how = f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        return how + self._last_words()

    def _last_words(self) -> str:
        words = shown(self._words.decode(errors="replace"), 4 * LAST_WORDS)
        return f", its last words: '{words[-LAST_WORDS:]}'" if words else " without a word"


def shown(text: str, most: int) -> str:
    """Return the beginning of what a plant said, in one line, without what commands a terminal."""
    words = " ".join(text[: 2 * most].split())
    return printable(words)[:most]
