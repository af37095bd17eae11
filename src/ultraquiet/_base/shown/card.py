"""An object as a card in a notebook: its line, what its status says, a sparkline, its channels, its numbers."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any, cast

from ultraquiet._base.shown.line import attributes, line, text
from ultraquiet._base.shown.sparkline import curve, sparkline

MOST_CHANNELS, MOST_ROWS = 24, 12
HOLDERS = ("model", "controller", "response", "system", "S", "opened", "bench", "law")
WIRES = (("actuators", "input"), ("sensors", "output"), ("channels", "channel"))
CELL = 'style="text-align:left;padding:0 1em 0 0"'


def card(shown: object) -> str:
    """Return an object as a piece of HTML without scripts, links or outside requests."""
    parts = [f"<div><code>{escape(line(shown))}</code>"]
    if sentence := getattr(getattr(shown, "status", None), "sentence", ""):
        parts.append(f"<p>{escape(sentence)}</p>")
    if (found := curve(shown)) and (drawn := sparkline(found[1])):
        parts.append(f"<p>{drawn} <small>{escape(found[0])}</small></p>")
    rows = [(role, c.name, c.unit, _limits(c)) for role, c in wires(shown)]
    if rows:
        parts.append(_table(("", "name", "unit", "limits"), rows[:MOST_CHANNELS]))
        if len(rows) > MOST_CHANNELS:
            parts.append(f"<p>and {len(rows) - MOST_CHANNELS} more channels</p>")
    facts = [
        (key, text(value)) for key, value in attributes(shown) if key not in {"status", *(name for name, _ in WIRES)}
    ]
    parts.append(f"<details><summary>more</summary>{_table(('', ''), facts[:MOST_ROWS])}</details></div>")
    return "".join(parts)


def wires(shown: object) -> Iterator[tuple[str, Any]]:
    """Yield the channels of an object with what they are; of one without, those of the first value that it holds."""
    found = False
    for name, role in WIRES:
        given = getattr(shown, name, None)
        if isinstance(given, Sequence) and not isinstance(given, str):
            for each in cast("Sequence[Any]", given):
                if hasattr(each, "name") and hasattr(each, "unit"):
                    found = True
                    yield role, each
    if found:
        return
    held = dict(attributes(shown))
    for name in HOLDERS:
        if name in held and (inside := list(wires(held[name]))):
            yield from inside
            return


def _limits(channel: Any) -> str:
    low, high = getattr(channel, "low", -float("inf")), getattr(channel, "high", float("inf"))
    return f"{low:g} to {high:g}" if max(-low, high) < float("inf") else ""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th {CELL}>{escape(each)}</th>" for each in head)
    body = "".join(f"<tr>{''.join(f'<td {CELL}>{escape(str(each))}</td>' for each in row)}</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"
