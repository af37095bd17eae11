"""Bytes of the state struct on a 32-bit target, read from the generated header; no compiler is asked."""

import re

_WORD = 4  # bytes of a pointer and of uint32_t
_SIZES = {"uint8_t": 1, "bool": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": _WORD, "int32_t": _WORD}
_WIDE = {"uint64_t": 8, "int64_t": 8, "float": 4, "double": 8}
_MEMBER = re.compile(r"(?:const |volatile )*(\w+) (\*?)\s*(?:const )?(\w+)((?:\[[^]]+\])*);")


def state_bytes(header: str, name: str) -> int | None:
    """Return the size of `struct NAME_state` with the natural alignment of each member; None if it cannot be read.

    >>> text = "typedef float c_real; struct c_state { c_real x[3U]; uint32_t mode; void (*hook)(void); };"
    >>> state_bytes(text, "c")
    20
    """
    plain = re.sub(r"/\*.*?\*/", " ", header, flags=re.DOTALL)
    macros: dict[str, str] = dict(re.findall(r"#define (\w+) (\d+)U?\b", plain))
    sizes = _SIZES | _WIDE
    for kind, alias in re.findall(r"typedef (\w+) (\w+);", plain):
        if kind in sizes:
            sizes[alias] = sizes[kind]
    held = re.search(rf"struct {name}_state \{{(.*?)\n?\}};", plain, flags=re.DOTALL)
    return _total(held[1], sizes, macros) if held else None


def _total(body: str, sizes: dict[str, int], macros: dict[str, str]) -> int | None:
    at, widest = 0, 1
    for line in filter(None, (" ".join(part.split()) for part in body.split(";"))):
        if "(" in line:  # a pointer to a function
            size, count = _WORD, 1
        else:
            member = _MEMBER.fullmatch(line + ";")
            if member is None:
                return None
            size = _WORD if member[2] else sizes.get(member[1], 0)
            count = 1
            for length in re.findall(r"\[(\w+?)U?\]", member[4] or ""):
                count *= int(macros.get(str(length), str(length)))
        if size == 0:
            return None
        at += -at % size + size * count
        widest = max(widest, size)
    return at + -at % widest
