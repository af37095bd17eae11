"""TMS320C3x assembly as the package emits it, read and checked: formats, operands, places, symbols."""

import re
from dataclasses import dataclass, field
from functools import cache

ADDRESSING = {f"AR{k}" for k in range(8)} | {"IR0", "IR1", "BK"}
EXTENDED = {f"R{k}" for k in range(8)}
SPECIAL = {"DP", "SP", "ST", "IE", "IF", "IOF", "RS", "RE", "RC"}
INDIRECT = re.compile(r"^\*(\+\+|--|\+|-)?AR([0-7])(\+\+|--)?(?:\((\d+|IR0|IR1)\))?(%)?$")
PARALLEL = {
    ("MPYF3", "ADDF3"),
    ("MPYF3", "SUBF3"),
    ("MPYF3", "STF"),
    ("ADDF3", "STF"),
    ("SUBF3", "STF"),
    ("LDF", "LDF"),
    ("LDF", "STF"),
    ("STF", "STF"),
}
MOVES = ("LDF", "LDI", "LDFLT", "LDFGT", "STF", "STI", "PUSH", "PUSHF", "POP", "POPF", "LDP")
SUMS = ("CMPF", "RND", "FLOAT", "FIX", "MPYF3", "ADDF3", "SUBF3", "ROL", "ADDI")
SINGLE = {*MOVES, *SUMS, "RPTS", "RPTB", "NOP", "RETI", "RETS"}


class RefusedError(ValueError):
    """Text that is no C3x program, or one beyond this interpreter."""


@dataclass
class Half:
    """One operation: its name and operands."""

    name: str
    operands: list[str]


@dataclass
class Instruction:
    """One word of program."""

    halves: list[Half]
    address: int
    line: str
    uses: set[str] = field(default_factory=set)
    writes: set[str] = field(default_factory=set)


@cache
def indirect(text):
    """Return sign, register, step after, displacement and % of an indirect operand."""
    return INDIRECT.match(text).groups()


@cache
def operand_kind(text):
    if text in EXTENDED:
        return "R"
    if text in ADDRESSING or text in SPECIAL:
        return "other"
    if text.startswith("*"):
        return "memory"
    return "direct" if text.startswith("@") else "immediate"


class Program:
    """Sections placed by the linker's file, symbols resolved, every instruction checked for its format."""

    def __init__(self, assembly, linker):
        places = {k.lstrip("."): int(v, 16) for k, v in re.findall(r"([.\w]+): load = (0x[0-9A-F]+)", linker)}
        self.symbols, self.code = {}, {}
        self._section, self._here, self._pending = "", dict(places), []
        for raw in assembly.splitlines():
            text = raw.split(";")[0].rstrip()
            if label := re.match(r"^(\w+):$", text):
                self.symbols[label[1]] = self._here[self._section]
            elif constant := re.match(r"^(\w+)\s+\.set\s+(\S+)$", text):
                self.symbols[constant[1]] = int(constant[2], 0)
            elif text.strip():
                name, _, rest = text.strip().partition(" ")
                self._line(name, rest.strip(), raw)
        self.spans = {section: range(begin, self._here[section]) for section, begin in places.items()}
        self.words = {at: self._resolve(text) & 0xFFFFFFFF for at, text in self._pending}
        for instruction in self.code.values():
            _check(instruction)
            _note(instruction)

    def _line(self, name, rest, line):
        section = self._section
        if name == "||":
            self._parallel(self._here[section] - 1, rest, line)
        elif not name.startswith("."):
            self._single(self._here[section], name, rest, line)
            self._here[section] += 1
        elif name in (".sect", ".text"):
            self._section = rest.strip('"') or "text"
        elif name == ".space":
            self._here[section] += int(rest)
        elif name == ".word":
            self._pending.append((self._here[section], rest))
            self._here[section] += 1
        elif name not in (".global", ".end"):
            raise RefusedError(f"directive {name}")

    def _single(self, at, name, rest, line):
        if name not in SINGLE:
            raise RefusedError(f"instruction {name!r} in {line!r}")
        self.code[at] = Instruction([Half(name, [o.strip() for o in rest.split(",")] if rest else [])], at, line)

    def _parallel(self, at, rest, line):
        name, operands = rest.split(None, 1)
        self.code[at].halves.append(Half(name, [o.strip() for o in operands.split(",")]))
        self.code[at].line += " " + line.strip()

    def _resolve(self, text):
        total = 0
        for term in map(str.strip, text.split("+")):
            total += self.symbols[term] if term in self.symbols else int(term, 0)
        return total


def _check(ins):
    names = tuple(h.name for h in ins.halves)
    kinds = [[operand_kind(o) for o in h.operands] for h in ins.halves]
    found = [m for h in ins.halves for o in h.operands if (m := INDIRECT.match(o))]
    used = [m[2] for m in found]
    if len(ins.halves) == 2 and names not in PARALLEL:
        raise RefusedError(f"no such pair: {ins.line}")
    if any(_modifies(m) and used.count(m[2]) > 1 for m in found):
        raise RefusedError(f"a register moved and used again: {ins.line}")
    if len(ins.halves) == 2 or names[0].endswith("3"):
        for o in (o for h in ins.halves for o in h.operands if operand_kind(o) == "memory"):
            shift = INDIRECT.match(o)
            if not shift or shift[4] not in (None, "1", "IR0", "IR1"):
                raise RefusedError(f"a displacement beyond 1: {ins.line}")
    if len(ins.halves) == 2:
        _check_pair(ins, names, kinds)
    elif names[0].endswith("3") and (kinds[0][2] != "R" or not set(kinds[0]) <= {"R", "memory"}):
        raise RefusedError(f"operands: {ins.line}")


def _check_pair(ins, names, kinds):
    first, second = ins.halves
    if not set(kinds[0] + kinds[1]) <= {"R", "memory"}:
        raise RefusedError(f"operands: {ins.line}")
    if names[0] == "MPYF3" and names[1] in ("ADDF3", "SUBF3"):
        four = kinds[0][:2] + kinds[1][:2]
        if four.count("memory") != 2:
            raise RefusedError(f"not two of four from memory: {ins.line}")
        if first.operands[2] not in ("R0", "R1") or second.operands[2] not in ("R2", "R3"):
            raise RefusedError(f"results of a pair go to R0-1 and R2-3: {ins.line}")
    elif names[1] == "STF":
        loads = kinds[0][:-1]
        wanted = ["memory", "R"] if names[0].endswith("3") else ["R"] if names[0] == "STF" else ["memory"]
        if sorted(loads) != sorted(wanted) or kinds[1] != ["R", "memory"]:
            raise RefusedError(f"operands: {ins.line}")


def _modifies(match):
    return match[3] is not None or match[1] in ("++", "--")


def _note(ins):
    """Fill in which registers the address generation uses and which the execution writes."""
    for half in ins.halves:
        for o in half.operands:
            if INDIRECT.match(o):
                ins.uses.add("AR")
            elif o.startswith("@"):
                ins.uses.add("DP")
        if half.name in ("LDI", "POP") and half.operands[-1] in ADDRESSING:
            ins.writes.add("AR")
        if half.name == "LDP" or (half.name == "POP" and half.operands[-1] == "DP"):
            ins.writes.add("DP")
