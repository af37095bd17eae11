"""The shipped vectors of the C31's frame, played on the text by the interpreter."""

import csv

import numpy as np
from c31_interpreter import Machine
from c31_numbers import low_bits
from c31_program import ADDRESSING, EXTENDED, SPECIAL, Program

ZERO = 0x80000000


class Played:
    """A text with its vectors; `difference` says where a text first departs from them."""

    def __init__(self, linker, table):
        self.linker = linker
        (_, self.sum), head, *rows = csv.reader(table.splitlines())
        self.counts = {what: sum(name.startswith(what) for name in head) for what in ("adc", "dac", "u", "x")}
        self.rows = [[int(cell, 0) for cell in row] for row in rows]
        self.sum, self.cycles = int(self.sum, 0), None

    def difference(self, assembly, only_states=False):
        """Return what is wrong with a text: refused, other words, registers or cycles; None when nothing is.

        With `only_states` any words stand in the state section to begin with but for the law's states: what a frame
        reads of it before writing it is nobody's.
        """
        try:
            program = Program(assembly, self.linker)
            if checked(program) != (self.sum, self.sum):
                return "check: another sum"
            machine = Machine(program)
            if only_states:
                first = program.symbols["controller_x"]
                others = sorted(set(program.spans["state"]) - set(range(first, first + self.counts["x"])))
                anything = np.random.default_rng(1).integers(2**32, size=len(others))
                machine.memory |= dict(zip(others, anything.tolist(), strict=True))
            for number, row in enumerate(self.rows):
                if found := self._frame(machine, row, row[0] and number):
                    return f"frame {number}: {found}"
        except (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError) as error:
            return f"refused: {error!r}"
        return None

    def _frame(self, machine, row, rested):
        """Run one frame, from rest where asked; the first one finds the states as the text has them."""
        symbols, at = machine.program.symbols, 1
        adc, dac, u, x = self.counts.values()
        if rested:
            machine.memory |= dict.fromkeys(range(symbols["controller_x"], symbols["controller_x"] + x), ZERO)
        held = _occupied(machine)
        for j in range(adc):
            machine.memory[symbols["ADC"] + j] = row[at + j] & 0xFFFFFFFF
        cycles = run(machine)
        words = [machine.memory.get(symbols["DAC"] + i) for i in range(dac)]
        if words != [code & 0xFFFFFFFF for code in row[at + adc : at + adc + dac]]:
            return "other codes"
        for name, size, first in (("u", u, at + adc + dac), ("x", x, at + adc + dac + u)):
            place = symbols[f"controller_{name}"]
            if [machine.memory.get(place + k) for k in range(size)] != row[first : first + size]:
                return f"other words of {name}"
        if _occupied(machine) != held:
            return "registers that an interrupt has to leave alone"
        self.cycles = cycles if self.cycles is None else self.cycles
        return None if cycles == self.cycles else f"{cycles} cycles in place of {self.cycles}"


MOST = 4000  # cycles of a small law's frame that has lost its way


def run(machine, start="controller_frame"):
    """Run one frame, or what begins at another label; what does not come back is refused."""
    execute = machine._execute

    def counted(here):
        if machine.cycles - begun > MOST:
            raise ValueError("does not end")
        return execute(here)

    begun, machine._execute = machine.cycles, counted
    try:
        return machine.run(start)
    finally:
        machine._execute = execute


def checked(program):
    """Return the word that the check of the tables leaves in R0, and the one that it is to be compared with."""
    machine = Machine(program)
    _occupied(machine)
    run(machine, "controller_check")
    return low_bits(machine.r["R0"]), machine.memory[program.symbols["controller_sum"]]


def _occupied(machine):
    """Return the registers as an interrupted program has them, set to other words on the way in."""
    if not getattr(machine, "interrupted", False):
        rng, machine.interrupted = np.random.default_rng(0), True
        for name in sorted(EXTENDED):
            machine.r[name] = (int(rng.integers(-20, 20)), int(rng.integers(2**31, 2**32)))
        for name in sorted((ADDRESSING | SPECIAL) - {"SP"}):
            machine.other[name] = int(rng.integers(1, 2**20))
    return dict(machine.r), dict(machine.other)
