"""An interpreter of the TMS320C3x assembly that the package emits: what it does, and how many cycles it takes.

Timing, from the TMS320C3x User's Guide (pipeline operation): one cycle an instruction; RPTS, RPTB, RETI and the
interrupt's entry four; a repeated instruction is not fetched again. Counted besides:
* a write to AR0-7, IR0-1 or BK by an instruction delays their use for an address by two cycles, the same for DP;
* two data buses: a store completes one cycle late, so one store before two reads, or two before one, costs a cycle;
* an internal block serves two accesses a cycle, the program's fetch among them; external memory serves one, and a
  write there holds the bus for two cycles.
What the text holds beyond these instructions, or an operand its format has no bits for, is refused (c31_program).
"""

import c31_numbers as num
from c31_program import ADDRESSING, EXTENDED, SINGLE, SPECIAL, RefusedError, indirect, operand_kind

BLOCKS = (0x809800, 0x809C00, 0x80A000)
STACK = 0x809F7F  # below its first word; internal, above the coefficients of any law that keeps them in block 1
FOUR = 4
SLOW = {"RPTS", "RPTB", "RETI", "RETS"}


def _block(address):
    """Return 1 or 2 for the internal blocks, 0 outside."""
    return 0 if address < BLOCKS[0] or address >= BLOCKS[2] else 1 if address < BLOCKS[1] else 2


class Machine:
    """Registers, memory, cycles."""

    def __init__(self, program):
        self.program = program
        self.memory = dict(program.words)
        self.other = dict.fromkeys(ADDRESSING | SPECIAL, 0)
        self.r = dict.fromkeys(EXTENDED, num.ZERO)
        self.other["SP"] = STACK
        self.cycles, self.stalls = 0, 0
        self.spent = {}
        self.verbs = {name: getattr(self, "_" + name.lower()) for name in SINGLE}

    def run(self, start, stop=None):
        """Execute from one label until another, or a return, is reached; return the cycles that took."""
        begin, here, end = self.cycles, self.program.symbols[start], self.program.symbols.get(stop)
        self.stores, self.age, self.bus_free = [], {"AR": 2, "DP": 2}, 0
        self.loop, region = None, start
        marks = {at: name for name, at in self.program.symbols.items() if at in self.program.code}
        while here != end:
            if here in marks and not marks[here].endswith("_last"):
                region = marks[here]
            before, name = self.cycles, self._at(here).halves[0].name
            here = self._execute(here)
            self.spent[region] = self.spent.get(region, 0) + self.cycles - before
            if name in ("RETI", "RETS"):
                break
        return self.cycles - begin

    def _at(self, here):
        if here not in self.program.code:
            raise RefusedError(f"no instruction at {here:#x}")
        return self.program.code[here]

    def _execute(self, here):
        """Execute the instruction at a place, with what it repeats, and return the next place."""
        ins = self._at(here)
        self._issue(ins, fetched=True)
        if ins.halves[0].name == "RPTS":
            here += 1
            for k in range(self.read_int(ins.halves[0].operands[0]) + 1):
                self._issue(self._at(here), fetched=k == 0)
        elif ins.halves[0].name == "RPTB":
            last = self.program.symbols[ins.halves[0].operands[0]]
            if self.other["RC"] < 0:
                raise RefusedError(f"{self.other['RC']} repetitions of a block")
            self.loop = (here + 1, last, self.other["RC"])
        if self.loop and here == self.loop[1]:
            first, last, left = self.loop
            self.loop = (first, last, left - 1) if left > 0 else None
            self.other["RC"] = left - 1
            return first if left > 0 else here + 1
        return here + 1

    def _issue(self, ins, fetched):
        """Execute one instruction and count it with what holds the pipeline."""
        wait = max([2 - self.age[group] for group in ins.uses] + [0])
        if wait:
            self.stores = []
        self.reads, written = [], []
        for kind, place, thing in filter(None, [self._perform(half) for half in ins.halves]):
            if kind == "memory":
                written.append(place)
                self.memory[place] = thing
            else:
                (self.r if kind == "R" else self.other)[place] = thing
        wait += self._conflicts([ins.address] if fetched else [])
        outside = [a for a in self.reads if not _block(a)]
        wait += max(0, self.bus_free - self.cycles - wait) if outside else 0
        cost = FOUR if ins.halves[0].name in SLOW else 1
        self.stalls += wait
        self.cycles += cost + wait
        if any(not _block(a) for a in written):
            self.bus_free = max(self.cycles, self.bus_free) + 2
        for group in self.age:
            self.age[group] = 0 if group in ins.writes else self.age[group] + cost + wait
        self.stores = written if cost == 1 else []

    def _conflicts(self, fetch):
        """Return the cycles that this instruction's reads wait for the stores before it and for each other."""
        if self.reads and len(self.reads) + len(self.stores) > 2:
            return 1
        at = [_block(a) for a in (*self.reads, *self.stores, *fetch)]
        outside = sum(not _block(a) for a in (*self.reads, *fetch))
        return int(at.count(1) > 2 or at.count(2) > 2 or outside > 1)

    def _address(self, text):
        if text.startswith("@"):
            target = self.program.symbols[text[1:]]
            if target >> 16 != self.other["DP"]:
                raise RefusedError(f"{text} lies on another page than DP")
            return target
        before, k, after, by, ring = indirect(text)
        name = f"AR{k}"
        base = self.other[name]
        step = self.other[by] if by in ("IR0", "IR1") else int(by or 1)
        if before in ("+", "++"):
            base = base + step
        elif before in ("-", "--"):
            base = base - step
        if before in ("++", "--"):
            self.other[name] = base
        if after:
            moved = base + step if after == "++" else base - step
            self.other[name] = self._ring(base, moved) if ring else moved
        return base

    def _ring(self, base, moved):
        size = self.other["BK"]
        mask = (1 << size.bit_length()) - 1
        index = (base & mask) + moved - base
        return (base & ~mask) | (index - size if index >= size else index + size if index < 0 else index)

    def _word(self, text):
        at = self._address(text)
        self.reads.append(at)
        if at not in self.memory:
            raise RefusedError(f"{text} reads {at:#x}, which nothing has written")
        return self.memory[at]

    def read_float(self, text):
        kind = operand_kind(text)
        if kind == "R":
            return self.r[text]
        if kind == "immediate":
            if float(text) != 0.0:
                raise RefusedError(f"a short float {text}")
            return num.ZERO
        return num.from_word(self._word(text))

    def read_int(self, text):
        kind = operand_kind(text)
        if kind == "R":
            return num.integer(self.r[text])
        if kind == "other":
            return self.other[text]
        if kind == "immediate":
            if not -(2**15) <= int(text, 0) < 2**15:
                raise RefusedError(f"{text} is beyond 16 bits")
            return int(text, 0)
        word = self._word(text)
        return word - 2**32 if word >> 31 else word

    def _perform(self, half):
        return self.verbs[half.name](*half.operands)

    def _ldf(self, src, dst):
        return "R", dst, self.read_float(src)

    def _ldi(self, src, dst):
        return self._put(dst, self.read_int(src))

    def _put(self, dst, number):
        return ("R", dst, num.from_integer(number, self.r[dst][0])) if dst in EXTENDED else ("other", dst, number)

    def _ldflt(self, src, dst):
        thing = self.read_float(src)
        return ("R", dst, thing) if self.sign < 0 else None

    def _ldfgt(self, src, dst):
        thing = self.read_float(src)
        return ("R", dst, thing) if self.sign > 0 else None

    def _cmpf(self, src, dst):
        gap = num.add(self.r[dst], num.negative(self.read_float(src)))
        self.sign = 0 if gap[0] == -128 else (1 if gap[1] > 0 else -1)

    def _rnd(self, src, dst=None):
        return "R", dst or src, num.rounded(self.r[src])

    def _float(self, src, dst):
        return "R", dst, num.floated(self.read_int(src))

    def _fix(self, src, dst):
        return self._put(dst, num.fixed(self.read_float(src)))

    def _stf(self, src, dst):
        return "memory", self._address(dst), num.to_word(self.r[src])

    def _sti(self, src, dst):
        return "memory", self._address(dst), num.low_bits(self.r[src])

    def _mpyf3(self, a, b, dst):
        return "R", dst, num.multiply(self.read_float(a), self.read_float(b))

    def _addf3(self, a, b, dst):
        return "R", dst, num.add(self.read_float(a), self.read_float(b))

    def _subf3(self, a, b, dst):
        less = num.negative(self.read_float(a))
        return "R", dst, num.add(less, self.read_float(b))

    def _ldp(self, label):
        return "other", "DP", self.program.symbols[label] >> 16

    def _nop(self, *moved):
        for text in moved:  # the pointer moves; a label or a count is the loops' own affair
            if operand_kind(text) == "memory":
                self._address(text)

    _rpts = _rptb = _reti = _rets = _nop

    def _rol(self, dst):
        low = num.low_bits(self.r[dst])
        return "R", dst, num.from_bits(self.r[dst][0], (low << 1 | low >> 31) & num.LOW)

    def _addi(self, src, dst):
        total = (self.read_int(src) + num.low_bits(self.r[dst])) & num.LOW
        return "R", dst, num.from_bits(self.r[dst][0], total)

    def _push(self, src):
        self.other["SP"] += 1
        word = num.low_bits(self.r[src]) if src in EXTENDED else self.other[src]
        return "memory", self.other["SP"], word & num.LOW

    def _pushf(self, src):
        self.other["SP"] += 1
        return "memory", self.other["SP"], num.to_word(self.r[src])

    def _pop(self, dst):
        word = self._pulled()
        return self._put(dst, word)

    def _popf(self, dst):
        return "R", dst, num.from_word(self._pulled())

    def _pulled(self):
        at = self.other["SP"]
        self.other["SP"] -= 1
        self.reads.append(at)
        return self.memory[at]
