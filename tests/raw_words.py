"""Words of the program that no reader should meet: names of fields, Python's constants, a change by less than zero."""

import re

RAW = re.compile(
    r"\b(?:True|False|None|NaN|nan|inf)\b"  # constants
    r"|<\w+(?:\.\w+)*: |<\w+ object|\b(?:StatusWord|Status|Verdict|Path|PosixPath|Channel|array|float64|dtype)[(.]\w*"
    r"|(?<![\w./\\-])[a-z]+(?:_[a-z0-9]+)+\b(?![\w./(\\-])"  # names of fields; not of files and calls
    r"|(?<![\w.])[A-Z]+_[A-Z_]+\b"
    r"|\b(?:by|quieter|louder|attenuated|amplified|reduced) (?:by )?[-\u2212]\d"
)


def raw_words(text):
    """Return what of a text a reader should not meet, each once."""
    return sorted({found.group(0) for found in RAW.finditer(text)})
