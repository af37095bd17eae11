"""Names of two studies that a reader tells apart: by title, else by bench, else by folder."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class NamedStudy:
    """What a study may be named by: its title, what its bench is called, the folder that it ran in."""

    title: str
    bench: str
    folder: Path


def told_apart(one: NamedStudy, other: NamedStudy) -> tuple[str, str]:
    """Return the names of two studies: no longer than it takes to tell them apart.

    Args:
        one: a study.
        other: the study beside it.

    Returns:
        Their titles; where those are alike with their benches; where those are alike too with their folders, and of
        these as many as differ. A study beside itself has one name.

    >>> hexapod = NamedStudy("Quiet", "hexapod", Path("runs/a/out"))
    >>> told_apart(hexapod, NamedStudy("Quiet", "plant.py", Path("runs/b/out")))
    ('Quiet on hexapod', 'Quiet on plant.py')
    >>> told_apart(hexapod, NamedStudy("Quiet", "hexapod", Path("runs/b/out")))
    ('Quiet in a/out', 'Quiet in b/out')
    """
    titles = one.title.strip() or "a study", other.title.strip() or "a study"
    if titles[0] != titles[1]:
        return titles
    if one.bench != other.bench:
        return f"{titles[0]} on {one.bench}", f"{titles[1]} on {other.bench}"
    mine, theirs = one.folder.resolve().parts, other.folder.resolve().parts
    for length in range(1, max(len(mine), len(theirs)) + 1):
        here, there = (Path(*parts[-length:]).as_posix() for parts in (mine, theirs))
        if here != there:
            return f"{titles[0]} in {here}", f"{titles[1]} in {there}"
    return titles
