"""A plant in another process, driven by lines of text: Simulink, LabVIEW, C++ or whatever can read and print."""

import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, whole
from ultraquiet._base.errors import BenchError, InputError, RunawayError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench.process.link import Child, Deadline, Link, shown
from ultraquiet.bench.process.protocol import SHOWN, Card, counted, number, read_token, refuse_unasked, spoken
from ultraquiet.bench.process.remote import Remote
from ultraquiet.bench.stepped import Setup, Stepped, SteppedPlant
from ultraquiet.values import Channel

START_TIMEOUT_S = 60.0  # MATLAB takes half of it before it says a word


class _Line:
    """The one thing of a bench that changes: its connection, and what the plant said of itself."""

    def __init__(self) -> None:
        self.link: Link | None = None
        self.card: Card | None = None
        self.busy = False
        self._end: weakref.finalize[Any, Any] | None = None

    def hold(self, link: Link) -> None:
        self.link = link
        self._end = weakref.finalize(self, link.close)  # a forgotten bench leaves no process behind

    def close(self) -> None:
        self.link, end, self._end = None, self._end, None
        if end is not None:
            end()

    def __reduce__(self) -> Any:
        return _Line, ()  # a bench that is sent to another process starts its own plant there


@register("bench", "process")
@dataclass(frozen=True)
class Process(Stepped):
    r"""A bench in another process, driven by the line protocol of docs/line-protocol.md.

    The plant is started (`command`) or called (`port`) when the bench is first asked for something, serves run after
    run, and ends with the bench. It names its rate and channels itself. As with `Wrapped`, at sample k it gets the
    command formed one sample before and the disturbance of this sample, and answers with the readings.

    Args:
        command: the program and its arguments; it speaks the protocol on its standard input and output.
        host, port: where a plant listens that was started by somebody else; instead of `command`.
        token_file: a file whose one word is said in the greeting, for a plant on a port that obeys nobody else.
        timeout_s: how long an answer may take, remarks and all.
        start_timeout_s: how long it may take to be ready; when absent 60 s for a plant that is started here, and
            `timeout_s` for one that listens already.

    Raises:
        InputError: neither or both of `command` and `port`, signals of the wrong shape.
        BenchError: the plant cannot be started, falls silent, dies, answers nonsense or NaN, or refuses; it is ended
            then, and the next run starts it afresh.

    >>> plant = r'''
    ... import sys
    ... for line in sys.stdin:
    ...     word, *rest = line.split()
    ...     if word == "hello":
    ...         print("ultraquiet-plant 1\nrate 100\nactuator V -5 5 force\nsensor V -inf inf speed\nready")
    ...     elif word == "step":
    ...         print("y", 2 * (float(rest[0]) + float(rest[1])))
    ...     else:
    ...         print("ok")
    ...     sys.stdout.flush()
    ... '''
    >>> import sys
    >>> with Process((sys.executable, "-c", plant)) as bench:
    ...     bench.run([[1.0, 9.0, 0.0]]).outputs.tolist()
    [[0.0, 2.0, 10.0]]
    """

    command: tuple[str, ...] = ()
    host: str = "127.0.0.1"
    port: int | None = None
    token_file: str = ""
    timeout_s: float = 10.0
    start_timeout_s: float | None = None
    _line: _Line = field(init=False, repr=False, compare=False, default_factory=_Line)

    def __post_init__(self) -> None:
        if bool(self.command) == (self.port is not None):
            raise InputError("Process: give either 'command', the program and its arguments, or 'port', not both.")
        if isinstance(self.command, str) or not all(isinstance(word, str) for word in self.command):
            raise InputError(f"Process: 'command' must be a sequence of texts, got {self.command!r}.")
        object.__setattr__(self, "command", tuple(self.command))
        if not isinstance(self.token_file, str):
            raise InputError(f"Process: 'token_file' must be the name of a file, got {self.token_file!r}.")
        if self.port is not None:
            whole("Process", "port", self.port, 1, 65535)
        if not isinstance(self.host, str) or not self.host:
            raise InputError(f"Process: 'host' must be the name or address of a machine, got {self.host!r}.")
        object.__setattr__(self, "timeout_s", positive("Process", "timeout_s", self.timeout_s, "s"))
        if self.start_timeout_s is not None:
            positive("Process", "start_timeout_s", self.start_timeout_s, "s")

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz, as the plant says."""
        return self._card.rate_hz

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The commands the plant takes."""
        return self._card.actuators

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The readings the plant gives."""
        return self._card.sensors

    @property
    def provenance(self) -> Provenance:
        """Who measures: the program or the address."""
        where = {"command": list(self.command)} if self.command else {"host": self.host, "port": self.port}
        return Provenance("bench.process", {**where, "rate_hz": self.rate_hz})

    def close(self) -> None:
        """End the plant; the next run starts it again."""
        self._line.close()

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _start_timeout_s(self) -> float:
        if self.start_timeout_s is not None:
            return float(self.start_timeout_s)
        return self.timeout_s if self.port else START_TIMEOUT_S

    @property
    def _card(self) -> Card:
        return self._line.card or self._connected()[1]

    def _connected(self) -> tuple[Link, Card]:
        line = self._line
        if line.link is None or line.card is None:
            token = read_token(self.token_file) if self.token_file else ""
            deadline = Deadline(self._start_timeout_s)
            link = Remote(self.host, self.port, deadline) if self.port else Child(self.command)
            line.hold(link)
            try:
                card = Card.from_handshake(link, deadline, token)
                if line.card is not None and card != line.card:
                    raise BenchError("Process: the plant has another rate or other channels than when it began before.")
            except BaseException:
                line.close()
                raise
            line.card = card
        assert line.link is not None
        return line.link, line.card

    def _setup(self) -> Setup:
        card = self._card
        return Setup("Process.run", _Driven(self), card.rate_hz, card.actuators, card.sensors)


class _Driven(SteppedPlant):
    """The plant's side of one run."""

    def __init__(self, bench: Process) -> None:
        self._bench = bench
        self._line = bench._line
        self._pending = self._late = 0
        self._mine = False

    def start(self, run_index: int) -> None:
        if self._line.busy:
            raise BenchError("Process: the plant is in the middle of another run; finish or close that one first.")
        self._mine = self._line.busy = True
        self._link, self._card = self._bench._connected()
        self._link.where = "at the start of a run"
        self._write = float.hex if self._card.hexadecimal else repr
        self._obey(f"reset {run_index}")

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        self._send(u[:, None], d[:, None])
        return self._answer(k)

    def advance(self, u: FloatArray, d: FloatArray, k: int) -> Iterator[FloatArray]:
        ahead, sent, m = self._card.ahead, 0, u.shape[1]
        for j in range(m):
            if sent < m and 2 * (sent - j) <= ahead:  # in bunches: a plant that never waits is the fastest
                until = min(j + ahead, m)
                self._send(u[:, sent:until], d[:, sent:until])
                sent = until
            yield self._answer(k + j)

    def overruns(self) -> int:
        late, self._late = self._late, 0
        return late

    def rest(self, error: BaseException | None) -> None:
        if not self._mine:
            return
        self._mine = self._line.busy = False
        if self._line.link is None or isinstance(error, BenchError):
            self._line.close()  # its state is unknown: the end of its input tells it to come to rest
            return
        try:
            while self._pending:
                self._answer(-1)
            self._link.where = "at the end of a run"
            self._obey("end")
        except BaseException:
            self._line.close()
            if error is None:
                raise

    def _send(self, u: FloatArray, d: FloatArray) -> None:
        write = self._write
        refuse_unasked(self._link, self._pending)
        lines = [f"step {' '.join(map(write, row))}\n" for row in np.concatenate([u, d]).T.tolist()]
        self._pending += len(lines)
        self._link.send("".join(lines))

    def _answer(self, k: int) -> FloatArray:
        self._link.where = f"at sample {k}"
        deadline = Deadline(self._bench.timeout_s)
        while (line := spoken(self._link, deadline)).split()[0] == "late":
            self._late += self._told_late(line)
            deadline.asides += 1
        word, *numbers = line.split()
        expected = len(self._card.sensors)
        try:
            y = np.array([number(w) for w in numbers])
        except (ValueError, OverflowError):
            y = np.empty(0)
        if word != "y" or y.size != expected or not np.isfinite(y).all():
            raise (RunawayError if word == "y" and y.size == expected else BenchError)(
                f"Process: at sample {k} the plant must answer 'y' and {expected} finite numbers, got "
                f"{shown(line, SHOWN)!r}."
            )
        self._pending -= 1
        return y

    def _told_late(self, line: str) -> int:
        try:
            _, count = line.split()
            return counted(count)
        except ValueError:
            raise BenchError(
                f"Process: {self._link.where} the plant must say 'late' and how many frames, got "
                f"{shown(line, SHOWN)!r}."
            ) from None

    def _obey(self, order: str) -> None:
        refuse_unasked(self._link, 0)
        self._link.send(order + "\n")
        line = spoken(self._link, Deadline(self._bench.timeout_s))
        if line.strip() != "ok":
            raise BenchError(f"Process: {self._link.where} the plant must answer 'ok', got {shown(line, SHOWN)!r}.")
