"""The words of the setting `structure`: what the channels of one controller have in common."""

from ultraquiet._base.constraints import one_of

FULL = "full"  # every command reads every measurement
REPEATED = "repeated"  # one scalar law on every channel, K = k I
DECENTRALISED = "decentralised"  # a scalar law of its own on every channel, K = diag(k1, k2, ...)
SYMMETRIC = "symmetric"  # scalar laws along given directions of all channels, some of them shared

# Words of 0.1, taken as before.
OLDER = {"alike": REPEATED, "apart": DECENTRALISED}


def structure_word(who: str, value: str, words: tuple[str, ...]) -> str:
    """Return the word for a structure, in place of an older one where that is given.

    Raises:
        InputError: none of `words`.

    >>> structure_word("FixedStructure", "apart", (FULL, DECENTRALISED))
    'decentralised'
    """
    newer = OLDER.get(value, value) if isinstance(value, str) else value
    return one_of(who, "structure", newer, words)
