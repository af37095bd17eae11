"""Sentences that count: one of a thing is never called by its plural."""

import ast
import re
from pathlib import Path

import pytest

import ultraquiet
from ultraquiet._base.shown.line import counted, several_of

SOURCE = Path(ultraquiet.__file__).parent
SPOKEN = ("pipeline", "plot", "report", "cli")  # rooms whose words are read by people who asked for no error
# What a number of things is called in the code; other numbers have units.
NUMBERS = {"samples", "states", "size", "benches", "records", "count", "lines"}
COUNTING = {"len", "sum", "count_nonzero"}
PLURAL = re.compile(r" (?!of )(?:[a-z-]+ )*?[a-z]{3,}s\b(?<!ss)(?<!is)(?<!us)")
# These never stand alone, as what is said before them shows.
SEVERAL = ("all ", "over the last ", "these are ")


def plurals(text):
    """Yield the line and the words of every f-string that counts things and always says many; errors are left out."""
    tree = ast.parse(text)
    raised = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Raise) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.JoinedStr) or id(node) in raised:
            continue
        for k, part in enumerate(node.values[:-1]):
            after = node.values[k + 1]
            before = node.values[k - 1] if k else None
            said = before.value if isinstance(before, ast.Constant) else ""
            if not isinstance(part, ast.FormattedValue) or not isinstance(after, ast.Constant) or not counts(part):
                continue
            if PLURAL.match(after.value) and not said.endswith(SEVERAL):
                yield node.lineno, f"{ast.unparse(part.value)}{after.value}"


def counts(part):
    value = part.value
    if part.format_spec is not None:
        return False
    if isinstance(value, ast.Call):
        function = value.func
        return (function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")) in COUNTING
    return (value.attr if isinstance(value, ast.Attribute) else getattr(value, "id", "")) in NUMBERS


def test_sentences_that_count_have_a_singular():
    found = [
        f"{path.relative_to(SOURCE)}:{line}: {words}"
        for room in SPOKEN
        for path in sorted((SOURCE / room).rglob("*.py"))
        for line, words in plurals(path.read_text(encoding="utf-8"))
    ]
    assert found == [], "say it with counted or several_of"


@pytest.mark.parametrize(
    ("sentence", "caught"),
    [
        ('f"The {len(modes)} strongest modes"', True),
        ('f"{facts.states} states"', True),
        ('f"In {len(clipped)} of them a sensor stood"', False),
        ('f"all {len(wires)} commands"', False),
        ('f"{seconds:.0f} s"', False),
        ('f"{len(rows)} class"', False),
    ],
)
def test_what_is_miscounted_is_found(sentence, caught):
    assert bool(list(plurals(sentence))) is caught


def test_words_follow_their_number():
    assert [counted(n, "law") for n in (0, 1, 2)] == ["0 laws", "1 law", "2 laws"]
    assert [counted(n, "frequency", "frequencies") for n in (1, 3)] == ["1 frequency", "3 frequencies"]
    assert [several_of(n, "is", "are") for n in (1, 5)] == ["is", "are"]
