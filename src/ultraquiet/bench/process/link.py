"""Lines of text to and from a plant in another process, over its standard input and output or over TCP."""

import os
import select
import signal
import socket
import subprocess
import tempfile
import time
from collections import deque
from contextlib import suppress
from typing import IO

from ultraquiet._base.errors import BenchError, InputError

CHUNK_BYTES = 1 << 16
LONGEST_LINE_BYTES = 1 << 20  # 40 000 numbers: more than any plant has channels, so it is no answer but rubbish
LAST_WORDS = 300  # characters of the plant's error output that a sentence quotes
GRACE_S = 1.0  # how long a plant may take to end by itself, then to obey SIGTERM
CONNECT_PAUSE_S = 0.05


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

    def line(self, timeout_s: float) -> str:
        """Return the next line without its end.

        Raises:
            BenchError: nothing came within `timeout_s`, the plant has ended, or what came is no line.
        """
        if not self._lines:
            self._pull(time.monotonic() + timeout_s, timeout_s)
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

    def _pull(self, deadline: float, timeout_s: float) -> None:
        while not self._lines:
            writes = [self._writes] if self._unsent else []
            ready, free, _ = select.select([self._reads], writes, [], max(deadline - time.monotonic(), 0.0))
            if not ready and not free:
                raise BenchError(
                    f"Process: {self.where} the plant '{self.name}' said nothing for {timeout_s:g} s and was given up; "
                    "allow it more time if it needs that."
                )
            if free:
                self._push()
            if ready:
                self._receive()

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


class Child(Link):
    """A plant that is started here, in a session of its own: Ctrl-C reaches the driver alone, which then ends it."""

    def __init__(self, command: tuple[str, ...]) -> None:
        if os.name != "posix":  # pipes cannot be waited for elsewhere
            raise InputError("Process: 'command' needs Linux or macOS; give 'port' and start the plant yourself.")
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                bufsize=0,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            self._words.close()
            raise BenchError(f"Process: the plant '{command[0]}' cannot be started ({error}).") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        reads, writes = self._process.stdout.fileno(), self._process.stdin.fileno()
        os.set_blocking(reads, False)
        os.set_blocking(writes, False)
        super().__init__(os.path.basename(command[0]), reads, writes)

    def _give(self, data: bytes) -> int:
        return os.write(self._writes, data)

    def _take(self, most: int) -> bytes:
        return os.read(self._reads, most)

    def close(self) -> None:
        """Close its input, which asks it to end; what does not end within a grace is killed. No zombie stays."""
        process = self._process
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        for order in (None, signal.SIGTERM, signal.SIGKILL):
            if order is not None and process.poll() is None:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, order)
            with suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
                break
        self._words.close()

    def ending(self) -> str:
        """Return its exit code or signal and its last words."""
        try:
            code = self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            return "closed its output" + self._last_words()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return how + self._last_words()

    def _last_words(self) -> str:
        self._words.seek(0)
        words = " ".join(self._words.read()[-4 * LAST_WORDS :].decode(errors="replace").split())
        return f", its last words: '{words[-LAST_WORDS:]}'" if words else " without a word"


class Remote(Link):
    """A plant that listens on a TCP port, on this machine or another."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                self._socket = socket.create_connection((host, port), timeout=timeout_s)
                break
            except OSError as error:
                # A plant that is just being started does not listen yet.
                if time.monotonic() + CONNECT_PAUSE_S > deadline or not isinstance(error, ConnectionRefusedError):
                    raise BenchError(f"Process: nothing answers on {host}, port {port} ({error}).") from error
                time.sleep(CONNECT_PAUSE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # an answer waits for every line
        self._socket.setblocking(False)
        super().__init__(f"{host}:{port}", self._socket.fileno(), self._socket.fileno())

    def _give(self, data: bytes) -> int:
        return self._socket.send(data)

    def _take(self, most: int) -> bytes:
        return self._socket.recv(most)

    def close(self) -> None:
        """Close the connection, which asks the plant to come to rest."""
        self._socket.close()

    def ending(self) -> str:
        """Return what is known: that it hung up."""
        return "closed the connection"
