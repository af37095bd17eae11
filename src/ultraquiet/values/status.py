"""The verdict that every result carries: a word to test and a sentence to read."""

from dataclasses import dataclass
from enum import StrEnum

from ultraquiet._base.errors import InputError


class StatusWord(StrEnum):
    """Every word that a status can carry, each with its `meaning`; a member equals its text.

    >>> StatusWord.NOT_WHITE == "not white", StatusWord("loss").meaning
    (True, 'The reduced controller costs the loop more than its budget allows.')
    """

    meaning: str

    def __new__(cls, word: str, meaning: str) -> "StatusWord":
        """Return a member whose text is the word."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.meaning = meaning
        return member

    def __repr__(self) -> str:
        return repr(self.value)

    OK = "ok", "The result can be used as it is."
    REFUSED = "refused", "The question has no answer as it was put; nothing was computed, and the sentence says why."
    UNSTABLE = "unstable", "A loop or a law is unstable, as it is or once it is reduced or rounded; do not run it."
    NOT_KNOWN = (
        "not known",
        "The longest record that was allowed does not tell whether the loop decays, "
        "or a hum at the mode's own frequency hides it.",
    )

    NOT_MEASURED = "not measured", "The loop settles; how quiet it is could not be told, and the sentence says why."

    DEAD = "dead", "The channel carries nothing that has to do with the others; mend it or leave it out."
    SATURATED = "saturated", "The channel's samples pile up at its limits; what lies beyond is lost."

    FEW_DATA = "few data", "The response is usable, its variance is rough: too few realisations or periods."

    NOT_CONVERGED = "not converged", "The search ended away from a minimum; the model is no estimate."
    NOT_WHITE = (
        "not white",
        "The model leaves something of the record unexplained; its deviations are too small.",
    )
    POOR_FIT = "poor fit", "The model's own output misses the data by more than noise explains."
    NOT_SYMMETRIC = (
        "not symmetric",
        "What should be alike differs by more than noise; identify each function by itself.",
    )
    UNKNOWN_IN_PART = "unknown in part", "The model's error reaches its whole size somewhere; nothing is known there."

    FRAGILE = (
        "fragile",
        "The loop is stable and keeps less margin than was asked, at an end of the plant that is named.",
    )
    NOT_ROBUST = "not robust", "The loop is stable, not for every plant within the uncertainty that was stated."
    SHORT = "short", "The best that was found misses a requirement; the sentence says which and by how much."
    LIMITED = "limited", "Commands of the adaptive law stand at their limit; the tone is only made smaller."
    DIVERGED = "diverged", "The adaptive law left its bounds and was brought to rest; reset it or mend the cause."
    NOT_CERTIFIED = "not certified", "No bound was found for what any linear controller can reach."
    LOSS = "loss", "The reduced controller costs the loop more than its budget allows."

    INEXACT = "inexact", "Rounding changes the law or its loop by more than the tolerance."
    DEGRADED = "degraded", "The loop with the rounded law is stable and attenuates less than the one designed."
    NO_COMPILER = "no compiler", "No C compiler was found; the code has not been run."
    NOT_COMPILED = "not compiled", "The compiler refused the code, or what it built could not be run."
    DIFFERS = "differs", "The compiled code does not give the bits of its twin; do not ship it."
    SELF_TEST_FAILED = "self-test failed", "The code agrees with its twin, the self-test shipped with it fails."
    UNSAFE = "unsafe", "Random bits at the entrances make the code do what no input may make it do."
    SOURCES_ONLY = "sources only", "The unit holds no binary for this machine; the importer must compile its sources."
    OVERRUN = "overrun", "Steps took longer than their frame; samples were skipped."
    BACKGROUND_LATE = "background late", "No step overran its frame, yet too little time was left for background work."


# Words of a proof after which code must not run.
CODE_FAULTS = (
    StatusWord.NOT_COMPILED,
    StatusWord.DIFFERS,
    StatusWord.SELF_TEST_FAILED,
    StatusWord.UNSAFE,
    StatusWord.UNSTABLE,
)


@dataclass(frozen=True)
class Status:
    """Verdict on a result. `ok` is the whole answer for a program, `sentence` for a person.

    `word` is a member of `StatusWord`; its text is taken too, any other word is refused (`InputError`).

    >>> bool(Status(StatusWord.NOT_CONVERGED, "The gradient is still large."))
    False
    """

    word: StatusWord
    sentence: str

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "word", StatusWord(self.word))
        except ValueError:
            known = ", ".join(repr(word) for word in StatusWord)
            raise InputError(f"Status: 'word' must be one of {known}; got {self.word!r}.") from None

    @property
    def ok(self) -> bool:
        """True when the result can be used as it is."""
        return self.word is StatusWord.OK

    def __bool__(self) -> bool:
        return self.ok

    def __str__(self) -> str:
        return f"{self.word}: {self.sentence}"
