"""The API as pages: every public name with its signature, its docstring and those of its public members.

Docstrings are read as they are written: the sections Args, Attributes, Returns and Raises become lists, examples become
code, indented equations stay as they stand. Shapes and units are in them, and a test refuses a name without one.
"""

import dataclasses
import inspect
import re
import textwrap

SECTIONS = ("Args", "Attributes", "Returns", "Raises")
HEAD = re.compile(rf"^({'|'.join(SECTIONS)}):\s*$")
ENTRY = re.compile(r"^(\*{0,2}[\w, *`]+?)(?: \(([^)]*)\))?: (.*)$", re.DOTALL)
OWN = "ultraquiet"


def rooms():
    """The public rooms by their path, the top first."""
    import ultraquiet as uq
    from ultraquiet import testing, values

    found = {"ultraquiet": uq}
    found |= {f"ultraquiet.{name}": getattr(uq, name) for name in uq.__all__ if inspect.ismodule(getattr(uq, name))}
    return {**found, "ultraquiet.values": values, "ultraquiet.testing": testing}


def names_of(path, room):
    """What a room exports: by `__all__`, of the room of errors its exceptions."""
    listed = getattr(room, "__all__", None)
    if listed is None:
        listed = [
            name for name, thing in vars(room).items() if inspect.isclass(thing) and thing.__module__ == room.__name__
        ]
    return [name for name in listed if not inspect.ismodule(getattr(room, name))]


def public():
    """Every public name with its object, by path; an object that has several names stands under each."""
    return {f"{path}.{name}": getattr(room, name) for path, room in rooms().items() for name in names_of(path, room)}


def documentation(thing):
    """The docstring of an object, or of what a name stands for."""
    if isinstance(thing, (int, float, str, tuple)) and not inspect.isclass(thing):
        return f"The value `{thing!r}`." if len(repr(thing)) < 60 else f"{len(thing)} values, the first `{thing[0]!r}`."
    return inspect.getdoc(thing) or ""


def markdown(text):
    """A docstring as Markdown."""
    out, lines = [], text.splitlines()
    k = 0
    while k < len(lines):
        head = HEAD.match(lines[k])
        if head:
            block, k = _indented(lines, k + 1)
            out += ["", f"**{head[1]}**", "", *_entries(block), ""]
        elif lines[k].startswith(">>>"):
            block, k = _example(lines, k)
            out += ["", "```pycon", *block, "```", ""]
        elif lines[k].startswith("    "):
            block, k = _indented(lines, k)
            out += ["", "```text", *textwrap.dedent("\n".join(block)).splitlines(), "```", ""]
        else:
            out.append(_escaped(lines[k]))
            k += 1
    return "\n".join(out).strip()


def _indented(lines, k):
    block = []
    while k < len(lines) and (lines[k].startswith("    ") or not lines[k].strip()):
        block.append(lines[k])
        k += 1
    while block and not block[-1].strip():
        block.pop()
    return block, k


def _example(lines, k):
    block = []
    while k < len(lines) and lines[k].strip():
        block.append(lines[k])
        k += 1
    return block, k


def _entries(block):
    """The entries of a section: a name at the left edge begins one, what is further in belongs to it."""
    text = textwrap.dedent("\n".join(block))
    entries = re.split(r"\n(?=\S)", text)
    for entry in entries:
        flat = " ".join(entry.split())
        found = ENTRY.match(flat)
        if found and len(entries) >= 1 and " " not in found[1].replace(", ", ""):
            shape = f" ({_escaped(found[2])})" if found[2] else ""
            yield f"* `{found[1]}`{shape}: {_escaped(found[3])}"
        else:
            yield f"* {_escaped(flat)}"


def _escaped(line):
    """Text whose asterisks, underscores, brackets and bars are no mark-up, outside of code."""
    parts = re.split(r"(`[^`]*`)", line)
    return "".join(p if p.startswith("`") else re.sub(r"([\\*_\[\]<>|#$])", r"\\\1", p) for p in parts)


def _signature(thing):
    """Names and defaults; types and shapes stand with the arguments."""
    try:
        parameters = [p for p in inspect.signature(thing).parameters.values() if p.name not in ("self", "cls")]
    except (TypeError, ValueError):
        return "()"
    shown = []
    for p in parameters:
        if p.kind is p.KEYWORD_ONLY and not any(s.startswith("*") for s in shown):
            shown.append("*")
        star = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        default = "" if p.default is p.empty else repr(p.default)
        plain = default if len(default) < 40 and "<" not in default else "..."
        shown.append(f"{star}{p.name}={plain}" if default else f"{star}{p.name}")
    return f"({', '.join(shown)})"


def _members(kind):
    """Public methods and properties of a class that this package wrote, each once."""
    fields = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    for name in sorted(dir(kind)):
        if name.startswith("_") or name in fields or name == "plot":
            continue
        member = inspect.getattr_static(kind, name)
        inner = getattr(member, "__func__", getattr(member, "fget", member))
        if str(getattr(inner, "__module__", "")).startswith(OWN) and inspect.getdoc(inner):
            yield name, member, inner


def _described(kind, path, signature, body, level):
    fence = ":" * level
    return f"{fence}{{py:{kind}}} {path}{signature}\n\n{body}\n{fence}\n"


def entry(path, thing):
    """One public name as a page's part."""
    body = markdown(documentation(thing))
    if inspect.isclass(thing):
        parts = [body]
        for name, member, inner in _members(thing):
            is_property = isinstance(member, property)
            signature = "" if is_property else _signature(inner)
            kind = "property" if is_property else "method"
            parts.append(_described(kind, f"{path}.{name}", signature, markdown(inspect.getdoc(inner)), 3))
        return _described("class", path, _signature(thing), "\n\n".join(parts), 4)
    kind = "function" if callable(thing) else "data"
    return _described(kind, path, _signature(thing) if callable(thing) else "", body, 4)


def write(folder):
    """Write a page a room, and one that lists them."""
    folder.mkdir(parents=True, exist_ok=True)
    shown, listed = {}, []
    for path, room in rooms().items():
        names = names_of(path, room)
        lines = [f"# {path}", "", markdown(inspect.getdoc(room) or ""), ""]
        for name in names:
            thing = getattr(room, name)
            home = shown.get(id(thing)) if inspect.isclass(thing) or callable(thing) else None
            if home is None:
                shown[id(thing)] = f"{path}.{name}"
                lines.append(entry(f"{path}.{name}", thing))
            else:
                lines.append(_described("data", f"{path}.{name}", "", f"The same as `{home}`.", 4))
        _put(folder / f"{path}.md", "\n".join(lines))
        listed.append(path)
    _put(
        folder / "index.md",
        "# The API\n\nEvery public name, written from the code: shapes and units stand with the arguments.\n\n"
        "```{toctree}\n:maxdepth: 1\n\n" + "\n".join(listed) + "\n```\n",
    )


def _put(path, text):
    if not path.exists() or path.read_text() != text:
        path.write_text(text)
