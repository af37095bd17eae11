"""The exit code of every command, decided in one place: from a verdict, or from the error that ended it."""

from enum import IntEnum
from typing import Protocol

import typer

from ultraquiet._base.errors import BenchError, NumericalError, StageError, ToolError, UltraquietError
from ultraquiet.values.status import StatusWord


class ExitCode(IntEnum):
    """What a command ends with, each with its `meaning`; the worse of two is the larger.

    >>> ExitCode.NOT_OK == 1, ExitCode(130).meaning
    (True, 'interrupted: by Ctrl-C or a signal; what was finished is kept')
    """

    meaning: str

    def __new__(cls, code: int, meaning: str) -> "ExitCode":
        """Return a member whose value is the code."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        return member

    DONE = 0, "done, and what was found is ok"
    NOT_OK = 1, "done and not ok: a requirement missed, a stage failed, or a result whose status is not ok"
    REFUSED = 2, "refused: bad input, or a question without an answer; the sentence says why"
    INTERRUPTED = 130, "interrupted: by Ctrl-C or a signal; what was finished is kept"


EPILOG = "Exit codes: " + "; ".join(f"{code.value} {code.meaning.partition(':')[0]}" for code in ExitCode) + "."

# Where the question was in order and the work on it failed.
FAILURES = (NumericalError, BenchError, ToolError, StageError)


class Judged(Protocol):
    """Anything that knows whether it can be used as it is: a `Status`, a study's summary."""

    @property
    def ok(self) -> bool:
        """True when it can."""
        ...


def exit_code(*outcomes: Judged | BaseException | None) -> ExitCode:
    """Return the exit code of a command that came to these outcomes: that of the worst; None judges nothing.

    >>> from ultraquiet.values import Status
    >>> exit_code(Status(StatusWord.OK, "Good."), Status(StatusWord.NOT_WHITE, "Not good.")).name
    'NOT_OK'
    """
    return max(map(_code, outcomes), default=ExitCode.DONE)


def finish(*outcomes: Judged | BaseException | None) -> None:
    """End the command with the code of what it came to; return where that is 0.

    Raises:
        Exit: with any other code.
    """
    code = exit_code(*outcomes)
    if code is not ExitCode.DONE:
        raise typer.Exit(int(code))


def _code(outcome: Judged | BaseException | None) -> ExitCode:
    if isinstance(outcome, KeyboardInterrupt):
        return ExitCode.INTERRUPTED
    if isinstance(outcome, FAILURES):
        return ExitCode.NOT_OK
    if isinstance(outcome, UltraquietError):
        return ExitCode.REFUSED
    if isinstance(outcome, BaseException):
        raise outcome  # a fault of this program, which no code describes
    if outcome is None or outcome.ok:
        return ExitCode.DONE
    refused = getattr(outcome, "word", None) is StatusWord.REFUSED
    return ExitCode.REFUSED if refused else ExitCode.NOT_OK
