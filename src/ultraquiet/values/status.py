"""The verdict that every result carries: a word to test and a sentence to read."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Status:
    """Verdict on a result. `ok` is the whole answer for a program, `sentence` for a person.

    >>> bool(Status("not converged", "The gradient is still large."))
    False
    """

    word: str
    sentence: str

    @property
    def ok(self) -> bool:
        """True when the result can be used as it is."""
        return self.word == "ok"

    def __bool__(self) -> bool:
        return self.ok

    def __str__(self) -> str:
        return f"{self.word}: {self.sentence}"
