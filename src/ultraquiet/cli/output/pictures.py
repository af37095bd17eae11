"""Figures into files: a name that is taken gets a number, nothing is written over."""

import os
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.cli.output.targets import is_folder, require_writable_place

if TYPE_CHECKING:
    from ultraquiet.plot import Figure

SVG, PNG = "svg", "png"
FORMATS = (SVG, PNG)


def require_format(who: str, form: str) -> str:
    """Return a known format of pictures."""
    return one_of(who, "--format", form, FORMATS)


def require_folder(who: str, folder: Path) -> None:
    """Refuse a folder that is something else."""
    if not is_folder(who, folder, "--out") and os.path.lexists(folder):
        raise StorageError(f"{who}: '{folder}' is a file, no folder for figures; choose another --out.")
    require_writable_place(who, folder, "--out")


def format_of_picture(who: str, path: Path) -> str:
    """Return the format that a picture's suffix says."""
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        endings = " or ".join(f".{each}" for each in FORMATS)
        raise InputError(f"{who}: '--out' must end in {endings}, got '{path}'.")
    return form


def picture_bytes(figure: "Figure", form: str) -> bytes:
    """Return a figure as the bytes of a file."""
    from ultraquiet.plot import draw_png, draw_svg

    return draw_png(figure) if form == PNG else draw_svg(figure).encode()


def save_pictures(who: str, figures: "Sequence[Figure]", folder: Path, stem: str, form: str) -> list[Path]:
    """Write figures into a folder, made where it is missing, as STEM-NAME, and number those whose name is taken."""
    from ultraquiet.files import reason

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{who}: '{folder}' cannot be made ({reason(error)}); choose another with --out.") from error
    return [save_numbered(folder / f"{stem}-{each.name}.{form}", picture_bytes(each, form)) for each in figures]


def save_numbered(path: Path, data: bytes) -> Path:
    """Write a file under its name, or with the first number behind it that is free; return where it is."""
    from ultraquiet.files import write_bytes

    for number in count(1):
        free = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        if free.exists():
            continue
        try:
            return write_bytes(free, data, overwrite=False)
        except StorageError:
            if not free.exists():  # not that somebody was faster
                raise
    raise AssertionError
