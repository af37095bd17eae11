"""What others wrote, fit to stand inside a sentence: one line, printable, not too long."""

LONGEST = 300


def one_line(text: object, most: int = LONGEST) -> str:
    r"""Return a text, or what an object calls itself, on one line; what cannot be shown is replaced.

    >>> one_line("two\n lines\x1b[31m"), one_line("long" * 10, 8)
    ('two lines�[31m', 'longl...')
    """
    try:
        words = text if isinstance(text, str) else repr(text)
    except Exception:  # an object of somebody else's may fail at anything
        words = f"<{type(text).__name__}>"
    words = " ".join(words[: 8 * most].split())
    shown = printable(words)
    return shown if len(shown) <= most else f"{shown[: most - 3]}..."


def printable(text: str, kept: str = "") -> str:
    r"""Return a text with what cannot be shown, but for characters that are kept, replaced.

    >>> printable("a\x1b[2J\nb", kept="\n")
    'a�[2J\nb'
    """
    return "".join(c if c in kept or c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def described(error: BaseException) -> str:
    """Return the kind of an error and what it says, on one line, also where it fails to say anything.

    >>> described(OSError("gone")), described(OSError())
    ('OSError: gone', 'OSError')
    """
    try:
        words = one_line(str(error))
    except Exception:
        words = ""
    return f"{type(error).__name__}: {words}" if words else type(error).__name__
