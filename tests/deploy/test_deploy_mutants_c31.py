"""The vectors shipped with the C31's text must notice every fault planted in it, last bits of coefficients included."""

import re
from collections import Counter

import pytest
from c31_vectors import Played
from test_deploy_c31 import bank_in, law_in

from ultraquiet.deploy.c31.assembly import c31_code
from ultraquiet.deploy.c31.pushes import SURELY, unlimited_shares
from ultraquiet.deploy.c31.vectors import vectors

SWAPS = [
    ("ADDF3", "SUBF3"),
    ("SUBF3", "ADDF3"),
    ("MPYF3", "ADDF3"),
    ("LDFLT", "LDFGT"),
    ("LDFGT", "LDFLT"),
    ("LDFLT", "LDF"),
    ("LDFGT", "LDF"),
    ("FLOAT", "LDI"),
    ("FIX ", "RND "),
    ("PUSHF", "PUSH"),
    ("POPF", "POP"),
    (r"\+\+", "--"),
    (r"--", "++"),
    (r"\*\+AR", "*-AR"),
    (r"\*-AR", "*+AR"),
    (r"\+\+\(1\)", ""),
    (r"\(IR0\)", "(1)"),
    (r"\(1\)", "(IR0)"),
    ("%", ""),
    (r"\bAR([0-6])", lambda m: f"AR{int(m[1]) + 1}"),
    (r"\bAR([1-7])", lambda m: f"AR{int(m[1]) - 1}"),
    (r"\bR([0-3])\b", lambda m: f"R{int(m[1]) + 1}"),
    (r"\bR([1-4])\b", lambda m: f"R{int(m[1]) - 1}"),
    (r"(LDI|RPTS) +(\d+)", lambda m: f"{m[1]}     {int(m[2]) + 1}"),
    (r"(LDI|RPTS) +(\d+)", lambda m: f"{m[1]}     {int(m[2]) - 1}"),
    (r"LDF +0\.0,R2", "LDF     0.0,R3"),
    ("LDI     @at_u", "LDI     @at_y"),
    ("LDI     @at_y", "LDI     @at_u"),
    (r"RC\b", "RE"),
    (r"IR0$", "IR1"),
    (r"BK$", "IR1"),
]
WORD = re.compile(r"(\.word +)(0x[0-9A-F]{8})")

# Faults that change nothing, and why; each is a pattern of the section, the line as it was and as it became.
EQUIVALENT = [
    (
        r"^text \|\| +ADDF3 +R0,R3,R3  ->  (left out|\|\| +SUBF3 +R0,R3,R3)",
        "the sum before the first state's is nobody's",
    ),
    (r"^text (.*)%(.*)  ->  \1\2", "the ring does not end there"),
    (r"^text NOP  ->  left out", "the pipeline waits as long by itself"),
    (
        r"^text LDI +@at_first,AR1  ->  (left out|LDI +@at_first,AR2)$",
        "for an odd number of commands the pointer stands behind the measurements already",
    ),
    (r"^state \.word +0x80000000  ->  \.word +0x80000001$", "zero has the exponent -128, whatever its mantissa"),
    (r"^table \.word +controller_ring  ->  .*\+ 1$", "a ring may begin at any of its words"),
]
SHARE = 400  # faults planted in each law of the long run
IDLE = "a gain needs no zero to begin with; without it the pipeline waits as long by itself"
UNSEEN = "what is cut off a gain's command corrects no state"
HELD = "the last command still stands there too"
FIRST = "a word other than a state: whatever these words are to begin with, the frames are the same"
FAR = "no measurement brings that command to its limit, which nothing takes"
LAST = "moves a pointer that nothing uses any more"


def bare(line):
    """Return an instruction without its comment."""
    return line.split(";")[0].strip()


def is_unused(lines, k, register):
    """Whether a pointer is loaded anew after a line before anything uses it again."""
    for line in map(bare, lines[k + 1 :]):
        if re.search(rf"(LDI|POP) .*{register}$", line):
            return True
        if re.search(rf"\b{register}\b", line):
            return False
    return True


MOVED = re.compile(r"\*(AR\d)((?:\+\+|--)\((?:1|IR0)\))?%?")


def is_last_move(lines, k, changed):
    """Whether a line differs by how it moves pointers afterwards, and these are loaded anew before they are used."""
    was, now = bare(lines[k]), bare(changed)
    if was.startswith("NOP     *") and now.startswith("NOP     *"):
        moved = re.findall(r"AR\d", was + now)
    elif MOVED.sub(r"*\1", was) == MOVED.sub(r"*\1", now):
        pairs = zip(MOVED.finditer(was), MOVED.finditer(now), strict=True)
        moved = [one[1] for one, other in pairs if one[0] != other[0]]
    else:
        return False
    return bool(moved) and all(is_unused(lines, k, register) for register in moved)


def is_last_command(lines, k, changed):
    """Whether a line compares the last command where the sum that it was rounded from still stands."""
    compared = (bare(lines[k]), bare(changed)) == ("CMPF    *AR4,R1", "CMPF    *AR4,R2")
    loads = [at for at, line in enumerate(lines) if re.match(r"LDF +\*AR2", bare(line))]
    # What a limit cut off another command stands there instead where the state hears of it.
    kept = len(loads) == 1 or not any(re.match(r"SUBF3 +\*AR2", bare(line)) for line in lines)
    return compared and kept and k > max(loads, default=-1)


TAKEN = re.compile(r"LDF(LT|GT) +\*AR4")


def is_out_of_reach(lines, k, law):
    """Whether a line takes a limit of a command which no measurement brings there."""
    if not TAKEN.match(bare(lines[k])):
        return False
    command, upper = divmod(sum(bool(TAKEN.match(bare(line))) for line in lines[:k]), 2)
    return bool(unlimited_shares(law)[command, 1 - upper] * SURELY < 1)


def label_of(lines, k):
    """Return the label that a line stands below."""
    return next((line.removesuffix(":") for line in reversed(lines[:k]) if re.fullmatch(r"\w+:", line)), "")


def is_overwritten(lines, k, changed):
    """Whether a line sets to zero what the next one overwrites: it stands between a store and two reads."""
    zeroed = re.fullmatch(r"LDF +0\.0,R[0-4]", bare(changed)) or not bare(changed)
    return bool(zeroed and "LDF     0.0,R2" in lines[k] and re.match(r"MPYF3 .*,R2$", bare(lines[k + 1])))


def is_of_a_gain(lines, k, law):
    """Whether a line takes what a limit cut off the command of a channel that has no states to correct."""
    cut = [at for at, line in enumerate(lines) if re.match(r"SUBF3 +\*AR2\+\+", bare(line))]
    of = [channel for channel, at in enumerate(cut) if k == at or (k == at + 2 and "STF" in lines[k])]
    return bool(of and law.channels) and law.channels[of[0]] == 0


def mutants(text):
    """Return (section, line number, line as it becomes), an empty one for an instruction left out."""
    made, section = [], ""
    for k, line in enumerate(text.splitlines()):
        code = line.split(";")[0].rstrip()
        if found := re.search(r'\.sect +"(\w+)"|\.(text)', code):
            section = found[1] or found[2]
        if not code.startswith((" ", "||")) or re.search(r"\.(sect|text|global|end)", code):
            continue
        if word := WORD.search(code):
            for step in (1, -1):
                made.append((section, k, f"{code[: word.start(2)]}0x{(int(word[2], 16) + step) & 0xFFFFFFFF:08X}"))
        elif ".word" in code:
            made += [(section, k, f"{code} + 1"), (section, k, f"{code} + -1")]
        else:
            made.append((section, k, ""))
            for pattern, other in SWAPS:
                for m in re.finditer(pattern, code):
                    swapped = other(m) if callable(other) else m.expand(other)
                    made.append((section, k, code[: m.start()] + swapped + code[m.end() :]))
    return list(dict.fromkeys(made))


def way_of(wrong):
    """Return in what way a fault was noticed: refused, other words, codes, cycles or registers."""
    words = wrong.partition(": ")[2].split() if wrong.startswith("frame") else ["refused"]
    return "other cycles" if "cycles" in words else words[0] if words[0] != "other" else " ".join(words[:2])


def unnoticed(law, planted):
    """Return the faults that the vectors miss, without those that change nothing."""
    code = c31_code(law)
    played, lines = Played(code.linker, vectors(law)), code.assembly.splitlines()
    assert played.difference(code.assembly) is None
    assert played.difference(code.assembly, only_states=True) is None
    every = mutants(code.assembly)
    chosen = planted(every)
    left, why = [], Counter()
    for section, k, line in chosen:
        wrong = played.difference("\n".join([*lines[:k], line, *lines[k + 1 :]]))
        if wrong is not None:
            why[way_of(wrong)] += 1
            continue
        change = f"{section} {bare(lines[k])}  ->  {line.strip() or 'left out'}"
        reasons = [reason for pattern, reason in EQUIVALENT if re.search(pattern, change)]
        reasons += [LAST] if is_last_move(lines, k, line) else []
        reasons += [UNSEEN] if is_of_a_gain(lines, k, law) else []
        reasons += [HELD] if is_last_command(lines, k, line) else []
        reasons += [FAR] if is_out_of_reach(lines, k, law) else []
        reasons += [FIRST] if section == "state" and label_of(lines, k) != "controller_x" else []
        reasons += [IDLE] if is_overwritten(lines, k, line) else []
        why[reasons[0] if reasons else "UNNOTICED"] += 1
        left += [] if reasons else [f"line {k + 1}: {change}"]
    print(f"{len(chosen)} of {len(every)} faults planted in {len(lines)} lines, {len(left)} unnoticed: {dict(why)}")
    return left


# No two alike, or a pointer that reads another command's limit would read the same number.
LIMITS = [[-1.0, 0.8], [-0.7, 1.2], [-1.1, 0.9]]


def test_the_vectors_notice_planted_faults(rng):
    law = law_in(rng, 4, "modal", True, 2, 2, limit_v=LIMITS[:2])
    assert unnoticed(law, lambda every: [every[k] for k in rng.choice(len(every), 24, replace=False)]) == []


# No loop of one pass alone and no ring of two, in which faults change nothing.
LAWS = {
    "modal": lambda rng: law_in(rng, 4, "modal", False, 4, 3, limit_v=LIMITS),
    "modal, anti-windup": lambda rng: law_in(rng, 4, "modal", True, 3, 2, limit_v=LIMITS[:2]),
    "delta": lambda rng: law_in(rng, 4, "delta", False, 4, 2, limit_v=LIMITS[:2]),
    "delta, anti-windup": lambda rng: law_in(rng, 6, "delta", True, 2, 2, limit_v=LIMITS[:2]),
    # Commands of one measurement go to their limits together, and each takes back what the others had.
    "delta, anti-windup, one measurement": lambda rng: law_in(rng, 6, "delta", True, 1, 3, limit_v=LIMITS),
    "six of each": lambda rng: law_in(
        rng, 8, "modal", True, 6, 6, limit_v=[*LIMITS, [-0.5, 0.6], [-1.3, 1.4], [-0.3, 1]]
    ),
    "bank": lambda rng: bank_in(rng, (2, 0, 1), "bank", False, limit_v=LIMITS),
    "bank-delta, anti-windup": lambda rng: bank_in(rng, (2, 0, 2), "bank-delta", True, limit_v=LIMITS),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", LAWS)
def test_the_vectors_notice_every_planted_fault(rng, share, case):
    """A drawn share of the faults of each law; `pytest --whole` plants them all."""
    print(f"{case}: ", end="")
    assert unnoticed(LAWS[case](rng), lambda every: share(every, SHARE)) == []
