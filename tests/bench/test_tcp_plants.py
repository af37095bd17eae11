"""Plants on a TCP port that lie, stall, flood or hang up, or are not there: one sentence each, in time."""

import os
import resource
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from ultraquiet._base.errors import BenchError, InputError
from ultraquiet.bench import Process
from ultraquiet.bench.process.link import Deadline
from ultraquiet.bench.process.remote import Remote

PLANT = Path(__file__).parents[2] / "docs" / "examples" / "plant.py"
HEAD = b"ultraquiet-plant 1\nrate 1000\nactuator V -5 5 push\nsensor V -10 10 pull\nahead %d\nready\n"
AT, TIMEOUT_S = 7, 0.3


@contextmanager
def listening(serve):
    """A peer on a port of its own; what it heard last is kept in the list that `serve` fills."""
    server = socket.create_server(("127.0.0.1", 0))

    def accept():
        with suppress(OSError):
            connection, _ = server.accept()
            with connection:
                serve(connection)

    thread = Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield server.getsockname()[1]
    finally:
        server.close()
        thread.join(20.0)


def plant(act, heard, ahead=1):
    def serve(connection):
        steps = 0
        with suppress(OSError):
            for line in connection.makefile("rb"):
                heard.append(line)
                word = line.split()[0]
                steps += word == b"step"
                if word == b"step" and steps == AT + 1:
                    act(connection)
                else:
                    connection.sendall({b"hello": HEAD % ahead, b"step": b"y 0.5\n"}.get(word, b"ok\n"))
        heard.append(b"gone")  # where a plant brings its actuators to zero

    return serve


def for_ever(words):
    def act(connection):
        while True:
            connection.sendall(words)

    return act


def reset(connection):
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    os.close(connection.detach())


ACTS = {
    "nothing": (lambda c: None, "said nothing for 0.3 s"),
    "half a line": (lambda c: c.sendall(b"y 0."), "said nothing for 0.3 s"),
    "half a line and the end": (lambda c: (c.sendall(b"y 0."), c.shutdown(socket.SHUT_RDWR)), "closed the connection"),
    "bytes": (lambda c: c.sendall(bytes(range(11, 256)) + b"\n"), "must answer 'y' and 1 finite numbers"),
    "NaN": (lambda c: c.sendall(b"y nan\n"), "must answer 'y' and 1 finite numbers, got 'y nan'"),
    "a line without end": (for_ever(b"1" * 65536), "bytes without an end of line"),
    "lines without end": (for_ever(b"y 1\n" * 20000), "answered 'y 1' before it was asked"),
    "empty lines without end": (for_ever(b"\n" * 65536), "said nothing but .* remarks for 0.3 s"),
    "drops": (lambda c: [(c.sendall(b"y"), time.sleep(0.05)) for _ in range(40)], "said nothing for 0.3 s"),
    "late": (lambda c: (time.sleep(0.5), c.sendall(b"y 1\n")), "said nothing for 0.3 s"),
    "two answers": (lambda c: c.sendall(b"y 1\ny 2\n"), "answered 'y 2' before it was asked; it must answer every"),
    "another answer": (lambda c: c.sendall(b"ok\n"), "must answer 'y' and 1 finite numbers, got 'ok'"),
}


@pytest.mark.parametrize("ahead", [1, 32])
@pytest.mark.parametrize("what", ACTS)
def test_a_peer_that_fails_is_one_sentence_in_time_and_is_told_to_rest(what, ahead):
    act, words = ACTS[what]
    heard: list[bytes] = []
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with listening(plant(act, heard, ahead)) as port:
        bench, begun = Process(port=port, timeout_s=TIMEOUT_S), time.monotonic()
        # Lines that are under way already may be answered before the failure shows, and half a line gets an end then.
        told = rf"at sample {AT} the plant.* {words}" if ahead == 1 else r"at sample \d+ the plant"
        with pytest.raises(BenchError, match=told) as caught:
            bench.run(np.ones((1, 40)))
        took_s = time.monotonic() - begun
    assert took_s < 10.0
    assert len(str(caught.value)) < 300
    assert heard[-1] == b"gone"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 << 10  # KB


def test_a_connection_that_is_torn_down_is_one_sentence():
    def serve(connection):
        connection.recv(99)
        reset(connection)

    with listening(serve) as port, pytest.raises(BenchError, match=r"in the handshake the plant .* closed the conn"):
        Process(port=port, timeout_s=5.0).run([[0.0]])


def test_the_handshake_of_a_plant_that_listens_has_the_time_of_an_answer():
    with listening(lambda c: c.recv(99) and c.recv(99)) as port, pytest.raises(BenchError, match=r"nothing for 0\.3 s"):
        Process(port=port, timeout_s=TIMEOUT_S).run([[0.0]])


@pytest.mark.parametrize("host", ["a" * 80, "a..b", "\udc80", "a\0b", "a\nb", "\x1b[2J"])
def test_no_name_at_all_is_one_plain_sentence(host):
    with pytest.raises(BenchError, match=r"nothing answers on .*, port 5") as caught:
        Process(host=host, port=5, timeout_s=TIMEOUT_S).run([[0.0]])
    assert str(caught.value).isprintable()


def test_no_host_at_all_is_refused():
    for host in ("", 5, None):
        with pytest.raises(InputError, match="'host' must be the name or address"):
            Process(host=host, port=5)


def test_a_name_that_nobody_resolves_costs_no_more_than_its_time(monkeypatch):
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: time.sleep(2.0) or [])
    begun = time.monotonic()
    with pytest.raises(BenchError, match=r"\(its name was not resolved within 0\.3 s\)"):
        Process(host="lab", port=5, timeout_s=TIMEOUT_S).run([[0.0]])
    assert time.monotonic() - begun < 1.5


def test_all_addresses_of_a_name_share_one_time(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    address = (socket.AF_INET, socket.SOCK_STREAM, 0, "", ("127.0.0.1", port))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [address] * 3)
    begun = time.monotonic()
    with pytest.raises(BenchError, match="connection refused"):
        Process(host="lab", port=port, timeout_s=TIMEOUT_S).run([[0.0]])
    assert time.monotonic() - begun < 1.0


def test_a_driver_that_reached_itself_has_reached_nobody(monkeypatch):
    real = socket.socket

    class Itself(real):
        """The system picks the port that is called as the caller's own, as it may below 61000."""

        def connect(self, address):
            self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self.bind(address)
            super().connect(address)

    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    monkeypatch.setattr(socket, "socket", Itself)
    with pytest.raises(BenchError, match=r"nothing answers on 127\.0\.0\.1, port"):
        Remote("127.0.0.1", port, Deadline(0.01))


def test_more_descriptors_than_select_can_count_are_no_harm():
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most[1] < 2000:
        pytest.skip("this system allows no more than 2000 open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(2000, most[0]), most[1]))
    held = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        with listening(plant(lambda c: c.sendall(b"y 0.5\n"), [])) as port, Process(port=port) as bench:
            assert bench.run(np.ones((1, 20))).samples == 20
    finally:
        for each in held:
            os.close(each)
        resource.setrlimit(resource.RLIMIT_NOFILE, most)


@pytest.mark.parametrize("timeout_s", [1e12, 1e300])
def test_a_time_without_end_is_one(timeout_s):
    good, times = plant(lambda c: c.sendall(b"y 0.5\n"), []), {"timeout_s": timeout_s, "start_timeout_s": timeout_s}
    with listening(good) as port, Process(port=port, **times) as bench:
        assert bench.run(np.ones((1, 20))).samples == 20


def test_the_plant_to_start_from_outlives_drivers_that_lie_and_hang_up():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    served = subprocess.Popen([sys.executable, "-S", str(PLANT), str(port)], stderr=subprocess.PIPE, text=True)
    try:
        with Process(port=port, start_timeout_s=20.0) as bench:
            assert bench.run(np.zeros((2, 3))).samples == 3
        for words in (
            b"step x\n",
            b"step\n",
            b"\xff\xfe\n",
            b"1" * (3 << 20),
            b"hello 1\nreset 0\n" + b"step 1 1 0 0\n" * 99,
        ):
            with socket.create_connection(("127.0.0.1", port)) as line, suppress(OSError):
                line.sendall(words)
                reset(line)  # with answers on their way
        with Process(port=port, start_timeout_s=20.0) as bench:
            assert not bench.run(np.zeros((2, 3))).outputs.any()
        assert served.poll() is None
    finally:
        served.kill()
        said = served.communicate()[1]
    assert "Traceback" not in said
