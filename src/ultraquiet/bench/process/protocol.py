"""The words of the line protocol (docs/line-protocol.md): the handshake, numbers, remarks and refusals."""

import re
from dataclasses import dataclass, replace

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import BenchError, InputError
from ultraquiet._base.regular import read_regular
from ultraquiet.bench.process.link import Deadline, Link, shown
from ultraquiet.values import Channel

VERSION = 1
GREETING = f"ultraquiet-plant {VERSION}"
MOST_AHEAD = 4096  # lines that may be under way: more gains nothing and only fills buffers
MOST_CHANNELS = 4096
MOST_TOKEN_BYTES = 1024
REASON = 500  # characters of a refusal that are told
UNASKED = ("#", "late", "error")  # what a plant may say of itself
SHOWN = 80  # characters of a wrong line that a sentence quotes

# ASCII digits only, no underscores, and no more of them than any program prints.
_DECIMAL = re.compile(r"[+-]?(?:(?:[0-9]{1,400}\.?[0-9]{0,400}|\.[0-9]{1,400})(?:[eE][+-]?[0-9]{1,5})?|inf|nan)")
_HEXADECIMAL = re.compile(r"[+-]?0[xX][0-9a-fA-F]{1,32}\.?[0-9a-fA-F]{0,32}(?:[pP][+-]?[0-9]{1,5})?")
_COUNT = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class Card:
    """What a plant says of itself in the handshake."""

    rate_hz: float = 0.0
    actuators: tuple[Channel, ...] = ()
    sensors: tuple[Channel, ...] = ()
    ahead: int = 1
    hexadecimal: bool = False

    @classmethod
    def from_handshake(cls, link: Link, deadline: Deadline, token: str = "") -> "Card":
        """Greet the plant, with a word that only its friends know where it asks for one, and read up to `ready`."""
        link.where = "in the handshake"
        link.send(f"hello {VERSION} {token}".rstrip() + "\n")
        first = spoken(link, deadline)
        if first.strip() != GREETING:
            raise BenchError(f"Process: the plant must greet with '{GREETING}', got {shown(first, SHOWN)!r}.")
        card = cls()
        while (line := spoken(link, deadline)).strip() != "ready":
            try:
                card = card._with(line.split())
            except (ValueError, IndexError, OverflowError) as error:
                raise BenchError(
                    f"Process: in the handshake the plant sent {shown(line, SHOWN)!r}, which says nothing known "
                    f"({error})."
                ) from None
        if not (card.rate_hz and card.actuators and card.sensors):
            raise BenchError("Process: the plant must name its rate, an actuator and a sensor before it is 'ready'.")
        return card

    def _joined(self, wires: tuple[Channel, ...], wire: Channel) -> tuple[Channel, ...]:
        if len(self.actuators) + len(self.sensors) >= MOST_CHANNELS:
            raise ValueError(f"a plant has up to {MOST_CHANNELS} channels")
        return (*wires, wire)

    def _with(self, words: list[str]) -> "Card":
        match words:
            case ["rate", value]:
                return replace(self, rate_hz=positive("Process", "rate", number(value), "Hz"))
            case ["actuator", unit, low, high, *name]:
                return replace(self, actuators=self._joined(self.actuators, channel(unit, low, high, name)))
            case ["sensor", unit, low, high, *name]:
                return replace(self, sensors=self._joined(self.sensors, channel(unit, low, high, name)))
            case ["ahead", count]:
                return replace(self, ahead=min(whole("Process", "ahead", counted(count), 1), MOST_AHEAD))
            case ["numbers", ("decimal" | "hex") as kind]:
                return replace(self, hexadecimal=kind == "hex")
        raise ValueError("known are rate, actuator, sensor, ahead, numbers and ready")


def channel(unit: str, low: str, high: str, name: list[str]) -> Channel:
    """Return the channel of a line of the handshake."""
    if not name:
        raise ValueError("a name is missing")
    return Channel(" ".join(name), unit, number(low), number(high))


def number(word: str) -> float:
    """Return a decimal or hexadecimal number, exactly.

    >>> number("0x1.8p+1"), number("1e-3")
    (3.0, 0.001)
    """
    if _DECIMAL.fullmatch(word):
        return float(word)
    if _HEXADECIMAL.fullmatch(word):
        return float.fromhex(word)
    raise ValueError(f"{shown(word, SHOWN)!r} is no number")


def counted(word: str) -> int:
    """Return a whole number in plain digits, of which nine are enough for everybody."""
    if not _COUNT.fullmatch(word):
        raise ValueError(f"{shown(word, SHOWN)!r} is no whole number below 10^9")
    return int(word)


def spoken(link: Link, deadline: Deadline) -> str:
    """Return the next line that is no remark."""
    while True:
        line = link.line(deadline)
        if line.startswith("error"):
            why = shown(line[5:], REASON).rstrip(".") or "no reason"
            raise BenchError(f"Process: {link.where} the plant refused: {why}.")
        if line.strip() and not line.startswith("#"):
            return line
        deadline.asides += 1


def refuse_unasked(link: Link, asked: int) -> None:
    """Refuse more answers than lines were sent: the next reading would be that of another sample.

    Raises:
        BenchError: with the first answer too many.
    """
    waiting = link.waiting()
    if len(waiting) <= asked:
        return
    answers = [line for line in waiting if line.strip() and not line.startswith(UNASKED)]
    if len(answers) > asked:
        raise BenchError(
            f"Process: {link.where} the plant '{link.name}' answered {shown(answers[asked], SHOWN)!r} before it was "
            "asked; it must answer every line once."
        )


def read_token(path: str) -> str:
    """Return the word of a token's file.

    Raises:
        InputError: it cannot be read, or holds anything but one word of plain letters, digits and signs.
    """
    try:
        words = read_regular(path, MOST_TOKEN_BYTES).decode("ascii").split()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Process: the token's file '{path}' cannot be read ({type(error).__name__}).") from error
    if len(words) != 1 or not words[0].isprintable():
        raise InputError(f"Process: the token's file '{path}' must hold one word, got {len(words)}.")
    return words[0]
