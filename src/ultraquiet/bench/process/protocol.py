"""The words of the line protocol (docs/line-protocol.md): the handshake, numbers, remarks and refusals."""

from dataclasses import dataclass, replace

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import BenchError
from ultraquiet.bench.process.link import Link
from ultraquiet.values import Channel

VERSION = 1
GREETING = f"ultraquiet-plant {VERSION}"
MOST_AHEAD = 4096  # lines that may be under way: more gains nothing and only fills buffers
SHOWN = 80  # characters of a wrong line that a sentence quotes


@dataclass(frozen=True)
class Card:
    """What a plant says of itself in the handshake."""

    rate_hz: float = 0.0
    actuators: tuple[Channel, ...] = ()
    sensors: tuple[Channel, ...] = ()
    ahead: int = 1
    hexadecimal: bool = False

    @classmethod
    def from_handshake(cls, link: Link, timeout_s: float) -> "Card":
        """Greet the plant and read its lines up to `ready`."""
        link.where = "in the handshake"
        link.send(f"hello {VERSION}\n")
        first = spoken(link, timeout_s)
        if first.strip() != GREETING:
            raise BenchError(f"Process: the plant must greet with '{GREETING}', got {first[:SHOWN]!r}.")
        card = cls()
        while (line := spoken(link, timeout_s)).strip() != "ready":
            try:
                card = card._with(line.split())
            except (ValueError, IndexError) as error:
                raise BenchError(
                    f"Process: in the handshake the plant sent {line[:SHOWN]!r}, which says nothing known ({error})."
                ) from None
        if not (card.rate_hz and card.actuators and card.sensors):
            raise BenchError("Process: the plant must name its rate, an actuator and a sensor before it is 'ready'.")
        return card

    def _with(self, words: list[str]) -> "Card":
        match words:
            case ["rate", value]:
                return replace(self, rate_hz=positive("Process", "rate", number(value), "Hz"))
            case ["actuator", unit, low, high, *name]:
                return replace(self, actuators=(*self.actuators, channel(unit, low, high, name)))
            case ["sensor", unit, low, high, *name]:
                return replace(self, sensors=(*self.sensors, channel(unit, low, high, name)))
            case ["ahead", count]:
                return replace(self, ahead=min(whole("Process", "ahead", int(count), 1), MOST_AHEAD))
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
    return float.fromhex(word) if "x" in word or "X" in word else float(word)


def spoken(link: Link, timeout_s: float) -> str:
    """Return the next line that is no remark."""
    while True:
        line = link.line(timeout_s)
        if line.startswith("error"):
            raise BenchError(f"Process: {link.where} the plant refused: {line[5:].strip().rstrip('.') or 'no reason'}.")
        if line.strip() and not line.startswith("#"):
            return line
