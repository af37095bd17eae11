"""A plant on a TCP port: found by its name, called, and heard, all within one time."""

import socket
import time
from concurrent.futures import Future
from threading import Thread
from typing import Any

from ultraquiet._base.errors import BenchError
from ultraquiet._base.shown.one_line import one_line
from ultraquiet.bench.process.link import CONNECT_PAUSE_S, Deadline, Link
from ultraquiet.files import reason

Address = tuple[Any, ...]  # family, kind, protocol and address, as the socket module has them


class Remote(Link):
    """A plant that listens on a TCP port, on this machine or another."""

    def __init__(self, host: str, port: int, deadline: Deadline) -> None:
        while True:
            try:
                self._socket = _called(_found(host, port, deadline), deadline)
                break
            except (OSError, UnicodeError) as error:
                # A plant that is just being started does not listen yet.
                if deadline.left_s() < CONNECT_PAUSE_S or not isinstance(error, ConnectionRefusedError):
                    raise BenchError(
                        f"Process: nothing answers on {one_line(host)}, port {port} ({reason(error)})."
                    ) from error
                time.sleep(CONNECT_PAUSE_S)
        super().__init__(f"{one_line(host)}:{port}", self._socket.fileno(), self._socket.fileno())

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


def _found(host: str, port: int, deadline: Deadline) -> list[Address]:
    """Return the addresses of a host; the system's resolver keeps no time of its own, so it is left behind when late.

    Raises:
        OSError: there is no such name, or nobody says so in time.
    """
    answer: Future[list[Address]] = Future()

    def ask() -> None:
        try:
            answer.set_result(list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)))
        except (OSError, UnicodeError) as error:
            answer.set_exception(error)

    Thread(target=ask, daemon=True).start()
    try:
        return answer.result(max(deadline.left_s(), 0.0))
    except TimeoutError:
        raise OSError(f"its name was not resolved within {deadline.timeout_s:g} s") from None


def _called(addresses: list[Address], deadline: Deadline) -> socket.socket:
    """Return a connection, which never blocks, to the first address that answers.

    Raises:
        OSError: what the last of them answered.
    """
    refusal = OSError("it has no address")
    for family, kind, protocol, _, address in addresses:
        line = socket.socket(family, kind, protocol)
        try:
            line.settimeout(max(deadline.left_s(), CONNECT_PAUSE_S))
            line.connect(address)
            _refuse_itself(line)
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # an answer waits for every line
            line.setblocking(False)
        except OSError as error:
            line.close()
            refusal = error
        except BaseException:
            line.close()
            raise
        else:
            return line
    raise refusal


def _refuse_itself(line: socket.socket) -> None:
    """Refuse a call that reached its caller: TCP may give it the very port of this machine on which nobody listens."""
    if line.getsockname() == line.getpeername():
        raise ConnectionRefusedError("nobody listens there")
