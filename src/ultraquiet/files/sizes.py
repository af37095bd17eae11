"""Numbers of bytes in words."""


def sized(count: int) -> str:
    """Return a number of bytes in words.

    >>> sized(1500), sized(3_200_000_000)
    ('1.5 kB', '3.2 GB')
    """
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{size:.3g} {unit}"
