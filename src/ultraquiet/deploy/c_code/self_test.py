"""The self-test's script: calls that visit every guard, with the digest of all bits they leave behind."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ultraquiet.deploy.c_code import self_test_text as text_of
from ultraquiet.deploy.law.coefficients import CoefficientBank, bank_from, numbers
from ultraquiet.deploy.law.law import Law, Rounded
from ultraquiet.deploy.law.twin import Twin

OPS = (
    "INIT",
    "ENABLE",
    "DISABLE",
    "CLEAR",
    "FRAME",
    "OUTPUT",
    "UPDATE",
    "SPEND",
    "LAG",
    "POKE",
    "JUMP",
    "EXCITE",
    "NARROW",
    "ATTACH",
    "LOAD",
    "SWAP",
    "SELECT",
    "RUN",
    "NOT_A_NUMBER",
    "INFINITE",
    "MINUS_INFINITE",
    "LARGE",
)

# FNV-1a, 32 bit: offset basis and prime of the FNV reference; LCG of Numerical Recipes.
FNV_BASIS, FNV_PRIME, MASK = 2166136261, 16777619, 2**32 - 1
LCG_FACTOR, LCG_STEP = 1664525, 1013904223
CANONICAL_NAN = 0x7FC00000
MOST_OVERRUNS = 8  # in a row that the script counts one by one
COMMENT = 22  # column at which a script's remarks begin
DRAWN_BITS = 24
HALF_RANGE = 2**23  # the generator's 24 bits, centred

# Bits of NaN, infinity, minus infinity, and of half the largest number, which overflows in the next sums.
SPECIAL = {
    "float32": {"NOT_A_NUMBER": 0x7FC00000, "INFINITE": 0x7F800000, "MINUS_INFINITE": 0xFF800000, "LARGE": 0x7EFFFFFF},
    "float64": {
        "NOT_A_NUMBER": 0x7FF8000000000000,
        "INFINITE": 0x7FF0000000000000,
        "MINUS_INFINITE": 0xFFF0000000000000,
        "LARGE": 0x7FDFFFFFFFFFFFFF,
    },
}


# Kinds of LOAD: a sound bank (every coefficient halved), a wrong CRC, NaN first, infinity last, a wrong bit.
LOADS = 5
SOUND, WRONG_CRC, NAN_FIRST, INFINITE_LAST, WRONG_BIT = range(LOADS)


@dataclass(frozen=True)
class ScriptRow:
    """One call (or `count` steps) with measurements of size `scale`, and the digest expected after it."""

    op: str
    count: int
    scale: float
    digest: int


def planted(coefficients: Rounded, kind: int) -> CoefficientBank:
    """Return the bank of a LOAD of some kind, with the CRC that goes with it."""
    row = coefficients * coefficients.dtype.type(0.5)
    words = np.dtype(f"<u{row.dtype.itemsize}")
    bits = SPECIAL[row.dtype.name]
    if kind == NAN_FIRST:
        row[0] = np.array([bits["NOT_A_NUMBER"]], words).view(row.dtype)[0]
    if kind == INFINITE_LAST:
        row[-1] = np.inf
    bank = bank_from(row)
    if kind == WRONG_CRC:
        return replace(bank, crc=bank.crc ^ 1)
    if kind == WRONG_BIT:
        changed = bank.words.copy()
        changed[-1] ^= 1
        return replace(bank, words=changed)
    return bank


def self_test(law: Law, quiet: float, loud: float) -> list[ScriptRow]:
    """Return the script for a law, its digests computed by the twin; the scales are those of `generator_scales`."""
    player = ScriptPlayer(law)
    calls = script_calls(law, quiet, loud)
    return [ScriptRow(op, count, scale, player.play(op, count, scale)) for op, count, scale in calls]


def script_calls(law: Law, quiet: float, loud: float) -> list[tuple[str, int, float]]:
    """Return the calls: ramps, limits on both sides, every kind of bad measurement, faults, overruns, restarts."""
    last = law.inputs - 1
    bad = [f"{op} {channel}" for op in ("NOT_A_NUMBER", "INFINITE", "MINUS_INFINITE") for channel in {0, last}]
    bad += [f"NOT_A_NUMBER {channel}" for channel in range(1, last)]
    large = [f"LARGE {k % law.inputs}" for k in range(4)]
    text = [
        text_of.START,
        text_of.OVERRUNS,
        *(f"{one}\n{text_of.AFTER_BAD}" for one in bad),
        text_of.FAULTS,
        *large,
        text_of.OVERFLOWS,
    ]
    text += [
        text_of.EXCITATIONS,
        *(f"EXCITE {2 + i}" for i in range(law.outputs)),
        text_of.STALLS,
        text_of.SWAPS,
        text_of.RETURNS,
    ]
    for channel in range(law.outputs):
        text += [f"INIT 0\nENABLE\nRUN 2\nNARROW {channel}\nRUN 6", text_of.EXCITED]
    some, near = min(law.ramp_steps, 7), min(law.ramp_steps, 4)
    names = {"ramp": law.ramp_steps, "some": some, "half": max(some // 2, 1), "last": last, "middle": law.states // 2}
    names |= {"near": near, "near_top": law.ramp_steps - near}
    # A limit of millions is reached from close by: every overrun before that does the same.
    counted = min(law.overrun_limit, MOST_OVERRUNS)
    names |= {"times": counted - 1, "times_twice": 2 * counted, "behind": 2 * (law.overrun_limit - counted)}
    names |= {"little": 2 * counted - 1} | _taps(law)
    calls = []
    for line in filter(None, "\n".join(text).splitlines()):
        words = line[:COMMENT].split()
        if words[0] == "LAG" and not names["behind"]:
            continue
        parts = (words[1:2] or ["0"])[0].replace("-", "+-").split("+")
        count = sum(names[word] if word in names else int(word) for word in parts)
        calls.append((words[0], count, loud if "loud" in words else quiet))
    return calls


def _taps(law: Law) -> dict[str, int]:
    """Return the counts of SELECT by name: tap + 16 signal + 256 channel."""
    return {
        "last_y": 16 + 256 * (law.inputs - 1),
        "last_x": 1 + 16 * 2 + 256 * (law.states - 1),
        "last_raw": 3 + 16 * 3 + 256 * (law.outputs - 1),
        "last_u": 2 + 16 * 4 + 256 * (law.outputs - 1),
        "low_limited": 16 * 5,
        "low_applied": 1 + 16 * 6,
        "past_y": 16 * 1 + 256 * law.inputs,
        "past_x": 16 * 2 + 256 * law.states,
        "past_u": 16 * 6 + 256 * law.outputs,
    }


class ScriptPlayer:
    """Plays a script on the twin, as the C program does on the code."""

    def __init__(self, law: Law) -> None:
        self.twin = Twin(law)
        self._coefficients = numbers(law)
        self._random = 1
        self.digest = FNV_BASIS
        self._word = np.dtype(f"<u{np.dtype(law.dtype).itemsize}")

    def play(self, op: str, count: int, scale: float) -> int:
        """Do one row and return the digest after it."""
        with np.errstate(all="ignore"):
            self._act(op, count, scale)
        self._look()
        return self.digest

    def _act(self, op: str, count: int, scale: float) -> None:
        twin = self.twin
        if op == "RUN":
            self._fold(self._bits(twin.run(self.measured(scale, count).T).T.ravel()))
        elif op == "INIT":
            twin.init(hook=count != 0)
        elif op == "DISABLE":
            twin.disable()
        elif op == "OUTPUT":
            twin.output(self.measure(scale))
        elif op == "UPDATE":
            twin.update()
        elif op in ("SPEND", "LAG", "POKE", "JUMP"):
            self._preset(op, count)
        elif op == "FRAME":
            self._fold([int(twin.frame()) for _ in range(max(count, 1))])
        elif op in ("ENABLE", "CLEAR"):
            self._fold([int(getattr(twin, op.lower())())])
        elif op in ("EXCITE", "NARROW", "ATTACH", "LOAD", "SWAP", "SELECT"):
            self._ask(op, count)
        else:
            y = self.measure(scale)
            bits = SPECIAL[twin.law.precision][op]
            y[count] = np.array([bits], self._word).view(twin.law.dtype)[0]
            self._step(y)

    def _preset(self, op: str, count: int) -> None:
        """Put one number of the state somewhere else."""
        twin = self.twin
        if op == "SPEND":
            twin.overruns = MASK - count
        elif op == "LAG":
            twin.late = count
        elif op == "POKE":
            twin.x[count] = np.inf
        else:
            twin.level = count

    def _ask(self, op: str, count: int) -> None:
        twin = self.twin
        if op == "EXCITE":
            self._fold([int(twin.excite(self._excitation(count)))])
        elif op == "NARROW":
            twin.narrow(count)
        elif op == "ATTACH":
            twin.attach()
        elif op == "LOAD":
            bank = planted(self._coefficients, count)
            self._fold([int(twin.load_bank(bank.words, bank.crc))])
            self._fold(self._bits(twin.numbers))
        elif op == "SWAP":
            self._fold([int(twin.swap(count != 0))])
        else:
            self._fold([int(twin.select(count % 16, count // 16 % 16, count // 256))])

    def _excitation(self, kind: int) -> NDArray[np.floating]:
        """Return three quarters of the upper and lower limits by turns (0), nine times them (1), NaN on a channel."""
        law = self.twin.law
        turns = law.excitation[np.arange(law.outputs), (np.arange(law.outputs) + self.twin.steps) % 2]
        v = turns * law.dtype(9.0 if kind == 1 else 0.75)
        if kind >= 2:
            v[kind - 2] = np.nan
        return v

    def measure(self, scale: float) -> NDArray[np.floating]:
        """Return the next measurements `(ny,)` of the generator."""
        return self.measured(scale, 1)[0]

    def measured(self, scale: float, steps: int) -> NDArray[np.floating]:
        """Return the next measurements `(steps, ny)`.

        The generator's k-th number from r is a^k r + c (1 + a + ... + a^(k-1)), all modulo 2^32 as unsigned words wrap.
        """
        law = self.twin.law
        count = steps * law.inputs
        powers = np.multiply.accumulate(np.full(count, LCG_FACTOR, np.uint32), dtype=np.uint32)
        sums = np.add.accumulate(np.concatenate([np.ones(min(count, 1), np.uint32), powers[:-1]]), dtype=np.uint32)
        random = powers * np.uint32(self._random) + sums * np.uint32(LCG_STEP)
        self._random = int(random[-1]) if count else self._random
        whole_numbers = (random >> np.uint32(8)).astype(np.int64) - HALF_RANGE
        return whole_numbers.astype(law.dtype).reshape(steps, law.inputs) * law.dtype(scale)

    def _step(self, y: NDArray[np.floating]) -> None:
        u = self.twin.output(y)
        self.twin.update()
        self._fold(self._bits(u))

    def _look(self) -> None:
        twin = self.twin
        commands = np.stack([twin.raw, twin.applied, twin.limited], axis=1).ravel()
        self._fold(self._bits(np.concatenate([commands, twin.y, twin.x])))
        self._fold(self._bits(np.concatenate([twin.excitation, twin.monitor()])))
        self._fold([number for tap in twin.taps for number in tap])
        if twin.law.L is not None:
            self._fold(self._bits(twin.cut))
        self._fold([twin.mode, twin.faults, twin.level, twin.steps, twin.clipped, twin.overruns])
        self._fold([twin.live, twin.busy, twin.late, twin.stalled, twin.resume, twin.loaded, twin.swapping, twin.bank])

    def _bits(self, values: NDArray[np.floating]) -> list[int]:
        """Return 32-bit words, low half first; one word for any NaN."""
        numbers = np.ascontiguousarray(values)
        words = numbers.view("<u4").reshape(numbers.size, numbers.itemsize // 4)
        nan = np.isnan(numbers)
        if not nan.any():
            return words.ravel().tolist()
        rows = zip(nan.tolist(), words.tolist(), strict=True)
        return [word for odd, halves in rows for word in ([CANONICAL_NAN] if odd else halves)]

    def _fold(self, words: Iterable[int]) -> None:
        digest = self.digest
        for word in map(int, words):
            digest = ((digest ^ word) * FNV_PRIME) & MASK
        self.digest = digest


def generator_scales(law: Law) -> tuple[float, float]:
    """Return generator scales, powers of two, that keep all commands inside their limits, and that meet most limits."""
    player = ScriptPlayer(law)
    player.twin.reset()
    with np.errstate(all="ignore"):
        y = np.stack([player.measure(1.0) for _ in range(200)], axis=1)
        raw = law.state_space().simulate(y.astype(np.float64))
    peak = np.abs(raw).max(axis=1)
    room = np.abs(law.limits.astype(np.float64)).min(axis=1)
    ratio = room[(peak > 0) & (room > 0)] / peak[(peak > 0) & (room > 0)]
    if not ratio.size or not np.all(np.isfinite(ratio)):
        return 2.0**-23, 2.0**-20
    powers = np.floor(np.log2(0.25 * ratio.min())), np.ceil(np.log2(16.0 * ratio.max()))
    # A measurement is such a scale times 24 bits, and both must be numbers of the law's own type.
    known = np.finfo(law.dtype)
    quiet, loud = (2.0 ** np.clip(power, known.minexp, known.maxexp - DRAWN_BITS - 1) for power in powers)
    return float(quiet), float(loud)
