"""On which line of a TOML text each key stands: tomllib does not say, and a mistake without a line is hard to mend."""

import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence

Place = tuple[str | int, ...]
# The line of a mistake in a table that was read from no text.
NO_LINE = 0
# Of mistakes and of one of them so much is printed: a table that was made to be wrong has millions.
MOST_TOLD, MOST_CHARACTERS = 100, 2000

_BLANK = re.compile(r"(?:\s|#[^\n]*)*")
_KEY = re.compile(r"""[ \t]*("(?:\\.|[^"\\\n])*"|'[^'\n]*'|[A-Za-z0-9_-]+)[ \t]*(\.?)""")
_TEXT = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}' + r"|'''.*?'{3,5}" + r'|"(?:\\.|[^"\\\n])*"' + r"|'[^'\n]*'",
    re.DOTALL,
)
_BARE = re.compile(r"[^,\]}\n#]*")


def line_numbers(text: str) -> Mapping[Place, int]:
    r"""Return the line, counted from one, of every table and key of a TOML text that tomllib has accepted.

    >>> places = line_numbers('title = "x"\n[[commands]]\ndo = "wait"\nseconds = 1.0\n')
    >>> places["commands", 0], places["commands", 0, "seconds"]
    (2, 4)
    """
    return _Scanner(text).places


def line_of(places: Mapping[Place, int], place: Place) -> int:
    """Return the line of a place, or of the innermost thing around it that has one; 1 for the whole file."""
    while place:
        if place in places:
            return places[place]
        place = place[:-1]
    return 1


def told(mistakes: Sequence[tuple[int, str]]) -> str:
    r"""Return mistakes (line, sentence) as lines below a sentence: the first of them, and how many more there are.

    >>> told([(3, "no such key."), (NO_LINE, "no such file.")])
    '\n  line 3: no such key.\n  - no such file.'
    """
    lines = [f"{'-' if line == NO_LINE else f'line {line}:'} {_short(said)}" for line, said in mistakes[:MOST_TOLD]]
    more = [f"- and {len(mistakes) - MOST_TOLD} more."] if len(mistakes) > MOST_TOLD else []
    return "".join(f"\n  {line}" for line in lines + more)


def _short(sentence: str) -> str:
    return sentence if len(sentence) <= MOST_CHARACTERS else f"{sentence[:MOST_CHARACTERS]} ..."


class _Scanner:
    """One walk through the text; it trusts tomllib to have found every fault of syntax."""

    def __init__(self, text: str) -> None:
        self.text = text.replace("\r\n", "\n")
        self._ends = [k for k, character in enumerate(self.text) if character == "\n"]
        self.at = 0
        self.places: dict[Place, int] = {}
        self._counts: dict[Place, int] = {}
        table: Place = ()
        self._skip()
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._skip()

    def _skip(self) -> None:
        match = _BLANK.match(self.text, self.at)
        assert match is not None
        self.at = match.end()

    def _keys(self) -> tuple[str, ...]:
        keys: list[str] = []
        dotted = "."
        while dotted and (match := _KEY.match(self.text, self.at)):
            key, dotted = match.groups()
            keys.append(key[1:-1] if key[0] in "\"'" else key)
            self.at = match.end()
        return tuple(keys)

    def _note(self, place: Place, start: int) -> None:
        self.places.setdefault(place, bisect_left(self._ends, start) + 1)

    def _header(self) -> Place:
        start = self.at
        many = self.text.startswith("[[", start)
        self.at += 2 if many else 1
        keys = self._keys()
        self.at += 2 if many else 1
        place: Place = ()
        for k, key in enumerate(keys):
            place = (*place, key)
            if many and k == len(keys) - 1:
                self._counts[place] = self._counts.get(place, -1) + 1
            if place in self._counts:
                self._note(place, start)
                place = (*place, self._counts[place])
            self._note(place, start)
        return place

    def _pair(self, table: Place) -> None:
        start = self.at
        place = table
        for key in self._keys():
            place = (*place, key)
            self._note(place, start)
        self.at = self.text.index("=", self.at) + 1
        self._value(place)

    def _value(self, place: Place) -> None:
        self._skip()
        self._note(place, self.at)
        opening = self.text[self.at]
        if opening in "[{":
            self._inside(place, opening)
            return
        match = (_TEXT if opening in "\"'" else _BARE).match(self.text, self.at)
        assert match is not None
        self.at = match.end()

    def _inside(self, place: Place, opening: str) -> None:
        closing = "]" if opening == "[" else "}"
        self.at += 1
        index = 0
        self._skip()
        while self.text[self.at] != closing:
            if opening == "[":
                self._value((*place, index))
            else:
                self._pair(place)
            index += 1
            self._skip()
            if self.text[self.at] == ",":
                self.at += 1
                self._skip()
        self.at += 1
