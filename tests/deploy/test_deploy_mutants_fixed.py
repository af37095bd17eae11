"""The self-test of whole-number code must notice every fault planted in it, coefficients by one count included."""

import re
from collections import Counter

import numpy as np
import pytest
from deploy_laws import code_in_words
from test_deploy_mutants import survivors

from ultraquiet.deploy.fixed_point.reach import all_corners

OTHERS = [
    (r" \+ ", " - "),
    (r" - ", " + "),
    (r" \* ", " + "),
    (r"\+=", "-="),
    (r"\+=", "="),
    (r"==", "!="),
    (r" < ", " > "),
    (r" < ", " <= "),
    (r" > ", " < "),
    (r" > ", " >= "),
    (r"<<", ">>"),
    (r">>", "<<"),
    (r"&&", "||"),
    (r"\(!s", "(s"),
    (r"\btrue\b", "false"),
    (r"\bfalse\b", "true"),
    (r"-TOP", "TOP"),
    (r"(?<!-)\bTOP\b", "-TOP"),
    (r"\bTOP\b", "(TOP - 1)"),
    (r"\bTOP\b", "(TOP + 1)"),
    (r"\b0U", "1U"),
    (r"\b1U", "0U"),
    (r"\b1U", "2U"),
    (r"\b2U", "1U"),
    (r"\b(N[XYU]|BLOCKS);", r"\1 - 1U;"),
    (r"_RAMP_STEPS\)", "_RAMP_STEPS - 1U)"),
    (r"_RAMP_STEPS\)", "_RAMP_STEPS + 1U)"),
    (r"(WIDE_BITS|\bs) - 1U", r"\1"),
    (r"\bp\b", "q"),
    (r"\bq\b", "p"),
    (r"\by0\b", "y1"),
    (r"\by1\b", "y0"),
    (r"\[0\]", "[1]"),
    (r"\[1\]", "[0]"),
    (r"\[2\]", "[3]"),
    (r"\[3\]", "[2]"),
    (r"\bsum0\b", "sum1"),
    (r"\bsum1\b", "sum0"),
    (r"\bA\[b\]", "A[0]"),
    (r"\b(next|drive)_p\b", r"\1_q"),
    (r"\b(next|drive)_q\b", r"\1_p"),
    (r"DOWN_A\[b\]", "DOWN_A[b] - 1U"),
    (r"DOWN_A\[b\]", "DOWN_A[b] + 1U"),
    (r"DOWN_B\[k\]", "DOWN_B[k + 1U]"),
    (r", (\d+)U\)", lambda found: f", {int(found[1]) + 1}U)"),
    (r", (\d+)U\)", lambda found: f", {int(found[1]) - 1}U)"),
]
STATEMENT = re.compile(r"\s+[^{}]*;(\s*/\*.*\*/)?")
DECLARED = re.compile(r"\s+(const )?(wide|bool|word|unsigned_wide|uint32_t) \w+ = |\s+return|\s+/\*")


TABLE = re.compile(r"static const \w+ (\w+)\[")

# Faults that change nothing, and why.
EQUIVALENT = [
    (r"- \(one << \(WIDE_BITS - 1U\)\);", "half of all unsigned numbers is its own negative modulo their count"),
    (r"for \(uint32_t j = 0U; j <= NY; j\+\+\) \{", "in init: the word behind y is `on`, which is written next"),
    (r"level <(= CONTROLLER_RAMP_STEPS| CONTROLLER_RAMP_STEPS \+ 1U)\) \{", "u 2^b rounded by b places is u"),
]


def mutants(code):
    """Return (line number, line as it becomes): every number of the tables by one count, every swap at every place."""
    lines, made, label = code.splitlines(), [], None
    for k, line in enumerate(lines):
        opened = TABLE.match(line)
        if opened:
            label, numbers = opened[1], line.find("= {") + 3
        elif label and line.startswith("    {"):
            numbers = 0
        else:
            label = None
        if label and numbers < len(line):
            for m in re.finditer(r"-?\d+", line[numbers:]):
                at, end = numbers + m.start(), numbers + m.end()
                made += [(k, f"{line[:at]}{int(m[0]) + step}{line[end:]}") for step in (1, -1)]
        elif not label and line.startswith("    "):
            for pattern, other in OTHERS:
                for m in re.finditer(pattern, line):
                    swapped = m.expand(other) if isinstance(other, str) else other(m)
                    made.append((k, line[: m.start()] + swapped + line[m.end() :]))
            if STATEMENT.fullmatch(line) and not DECLARED.match(line):
                made.append((k, ""))
    return list(dict.fromkeys(made))


def largest_effects(law, code):
    """Return line number -> what one count of a number in that line's table may change, in counts of what it forms.

    A count of a coefficient times the largest word, taken down as the sum is. Below one count it is less than the law's
    own rounding: then only a state that stands just on the edge of a rounding would show it.
    """
    effects, full = {}, 2.0 ** (law.bits - 1)
    downs = {
        "A": [full / 2.0 ** (a + law.bits - 2) for a in law.shift_a],
        "B": [full / 2.0 ** (b + law.bits - 2) for b in law.shift_b],
        "C": [min(full / 2.0 ** (law.shift_u + law.bits - 2))] * law.states,
        "D": [full / 2.0 ** (u + law.bits - 2) for u in law.shift_u],
    }
    label, row = None, 0
    for k, line in enumerate(code.splitlines()):
        if opened := TABLE.match(line):
            label, row = opened[1], 0
        elif label in downs and line.startswith("    {"):
            effects[k] = downs[label][row]
            row += 1
    return effects


def faint_drives(law):
    """Return which states their measurements move by less than a count, however large: as `largest_effects`."""
    return np.abs(law.B).sum(axis=1) * 2.0 ** (1 - law.shift_b) < 1.0


def unnoticed(folder, cc, law, planted):
    """Return the faults that the self-test misses, without those that change nothing or less than a count."""
    code = (folder / "controller.c").read_text()
    effects, left, why = largest_effects(law, code), [], Counter()
    alike = (law.shift_b[::2] == law.shift_b[1::2]).all()
    commands_alike = (law.shift_u == law.shift_u[0]).all()
    for said in survivors(folder, cc, code, planted):
        number, line = int(re.match(r"line (\d+)", said)[1]), said.partition("  ->  ")[2]
        reasons = [reason for pattern, reason in EQUIVALENT if re.search(pattern, line)]
        if alike and re.search(r"DOWN_B\[k \+ 1U\]\), \d+U\);$|DOWN_B\[k \+ 0U\]", line):
            reasons.append("both states of every block go down by the same places")
        was, becomes = (re.sub(r"DOWN_U\[\d\]", "", text).strip() for text in (code.splitlines()[number - 1], line))
        if commands_alike and was == becomes:
            reasons.append("all commands go down by the same places")
        places = re.search(r" DOWN_B\[\d+\] = \{(.*)\}", line)
        if places:
            now = [int(each.strip("U ")) for each in places[1].split(",")]
            if not np.any((np.array(now) != law.shift_b + 2) & ~faint_drives(law)):
                reasons.append("what goes down by other places is less than a count")
        forgets = re.search(r"sum(\d) = D\[\1\]\[j\]", line)
        if forgets and not law.D[int(forgets[1]), :-1].any():
            reasons.append("only the last input reaches that command at once")
        small = effects.get(number - 1, 1.0) < 1.0
        why[reasons[0] if reasons else "less than a count" if small else "UNNOTICED"] += 1
        left += [] if reasons or small else [said]
    print("; ".join(f"{count} {reason}" for reason, count in why.items()))
    return left


@pytest.mark.parametrize(("form", "scaling"), [("modal", "l2"), ("delta", "l1")])
def test_a_count_of_any_gain_is_seen_at_one_of_the_corners(rng, tmp_path, form, scaling):
    """Every state but those of which a count of the gain is less than one of the command, however large they are."""
    law = code_in_words(rng, tmp_path / "code", "q15", 4, 2, 2, ramp_s=0.004, form=form, scaling=scaling).law
    corners, down = all_corners(law)[0], law.shift_u + law.bits - 2
    x, y = corners[:, : law.states], corners[:, law.states :]
    commands = (x @ law.C + y @ law.D[:, : law.inputs].T + 2 ** (down - 1)) >> down
    inside = np.abs(commands) < law.top
    for i, k in np.ndindex(law.outputs, law.states):
        seen = np.abs(x[inside[:, i], k]).max(initial=0)
        assert seen >= min(2 ** int(down[i]), law.top // 2), (k, i)


def test_self_test_of_whole_numbers_notices_planted_faults(rng, tmp_path, cc):
    made = code_in_words(rng, tmp_path / "code", "q15", 4, 2, 2, ramp_s=0.004, form="modal", scaling="l2")
    every = mutants((tmp_path / "code" / "controller.c").read_text())
    drawn = [every[k] for k in rng.choice(len(every), 20, replace=False)]
    assert unnoticed(tmp_path / "code", cc, made.law, drawn) == []


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("word", ["q15", "q31"])
@pytest.mark.parametrize(
    ("form", "scaling", "loud"), [("modal", "l2", 1.0), ("delta", "l1", 1.0), ("modal", "l1", 8.0)]
)
def test_self_test_of_whole_numbers_notices_every_planted_fault(rng, tmp_path, cc, word, form, scaling, loud):
    made = code_in_words(rng, tmp_path / "code", word, 4, 2, 2, loud, ramp_s=0.004, form=form, scaling=scaling)
    every = mutants((tmp_path / "code" / "controller.c").read_text())
    assert len(every) >= 250
    assert unnoticed(tmp_path / "code", cc, made.law, every) == []
