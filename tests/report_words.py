"""What a report says, and whether it speaks of a bench that it is not about."""

import re

from ultraquiet.values import StatusWord

# Words of the packaged study; what else a report says must come from the bench it is about. A number is foreign as a
# whole, not as the end of another: 164.5 Hz is none of the three tones.
FOREIGN = re.compile(
    r"SUITE|strut|hexapod|\bground\b|\bflight\b|\bpaper|geophone|piezo|stack|payload|\d V\b|V²|V/V|eq\. \(|Fig\.|"
    r"section \d|(?<![\d.,])(?:5|25|100)(?:\.0+)? Hz|(?<![\d.,])3500\b|(?<![\d.,])(?:25|1000) V",
    re.IGNORECASE,
)


def visible(page):
    """Return the text of a report without its style, its scripts and where it says which versions made it."""
    text = re.sub(r"<(style|script)\b.*?</\1>", " ", page, flags=re.DOTALL)
    text = re.sub(r"<(path|use|g|clipPath|defs|svg|figure)\b[^>]*>", " ", text)
    return re.sub(r"<[^>]+>", " ", text)


def small_openings(page):
    """Verdicts that begin a sentence in lower case; after a colon, as "quiet: ok: ...", they go on with one."""
    words = "|".join(map(re.escape, StatusWord))
    return re.findall(rf"[.!?]\s+(?:{words}): [A-Z].{{20}}|<p>(?:{words}): [A-Z].{{20}}", page)


def foreign_words(page):
    return sorted({text.group(0) for text in FOREIGN.finditer(visible(page))})
