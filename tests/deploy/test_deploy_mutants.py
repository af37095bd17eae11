"""The shipped self-test must notice every fault planted in the guards of the generated code."""

import re
import subprocess

import pytest

from ultraquiet.deploy import generate

GUARDS = (
    "sound_measurements",
    "sound_commands",
    "rest",
    "quiet",
    "init",
    "enable",
    "disable",
    "clear",
    "frame",
    "excite",
    "latch",
    "limit",
    "ramp",
    "output",
    "waiting",
    "boundary",
    "update",
    "attach",
    "crc32",
    "load_bank",
    "swap",
    "read",
    "source",
    "select",
    "monitor",
)

SWAPS = [
    (r"==", "!="),
    (r"!=", "=="),
    (r" < (range|EXCITATION)", r" > \1"),
    (r" > (range|EXCITATION)", r" < \1"),
    (r"\.low\)", ".high)"),
    (r"\.high\)", ".low)"),
    (r"\? ([^\s\]]+) : ([^\s\]]+);", r"? \2 : \1;"),
    (r"&&", "||"),
    (r"\|\|", "&&"),
    (r"\+ 1U", "+ 2U"),
    (r"- 1U", "- 2U"),
    (r"\+ 2U", "+ 1U"),
    (r"\(2U \*", "(1U *"),
    (r"\+ rise", "- rise"),
    (r"- fall", "+ fall"),
    (r"\+ s->excitation", "- s->excitation"),
    (r"\+ met", "- met"),
    (r"= 1U;", "= 0U;"),
    (r"= 0U;", "= 1U;"),
    (r"return true;", "return false;"),
    (r"return false;", "return true;"),
    (r"\? 1U : 0U", "? 0U : 1U"),
    (r"< UINT32_MAX", "<= UINT32_MAX"),
    (r"_OVERRUN_LIMIT", "_OVERRUN_LIMIT + 1U"),
    (r">= \(2U", "> (2U"),
    (r">= (\w+_TAPS)", r"> \1"),
    (r">= channels", "> channels"),
    (r"> 0U", "> 1U"),
    (r"_RAMP_STEPS\)", "_RAMP_STEPS - 1U)"),
    (r"\|= fault", "= 0U * fault"),
    (r"_FAULT;", "_STOPPING;"),
    (r"_FAULT_INPUT\)", "_FAULT_OUTPUT)"),
    (r"_FAULT_OUTPUT\)", "_FAULT_INPUT)"),
    (r"_FAULT_OVERRUN\)", "_FAULT_INPUT)"),
    (r"_ON;", "_OFF;"),
    (r"_OFF;", "_ON;"),
    (r"_STOPPING;", "_OFF;"),
    (r"!sound", "sound"),
    (r"\* RAMP_STEP", "* (real)1"),
    (r"v\[0\] \* ZERO", "ZERO * ZERO"),
    (r"= on_overrun;", "= 0;"),
    (r"= ZERO;", "= (real)1;"),
    (r"i < NU", "i < NU - 1U"),
    (r"j < NY", "j < NY - 1U"),
    (r"i < NX", "i < NX - 1U"),
    (r"k < (\w+_(REALS|WORDS|TAPS));", r"k + 1U < \1;"),
    (r"k = 0U; k", "k = 1U; k"),
    (r"bit < 32U", "bit < 31U"),
    (r">> 1U", ">> 2U"),
    (r"0xEDB88320U", "0xEDB88321U"),
    (r"crc \^ UINT32_MAX", "crc"),
    (r"crc = UINT32_MAX", "crc = 0U"),
    (r"SWAP_KEEP : SWAP_RAMP", "SWAP_RAMP : SWAP_KEEP"),
    (r"= SWAP_NONE;", "= SWAP_KEEP;"),
    (r"= &FACTORY", "= NULL"),
    (r"spare = pair", "spare = NULL"),
    (r"spare\[0\]\) \?", "spare[1]) ?"),
    (r"channels = N\w;", "channels = 1U;"),
    (r"found = s->\w+", "found = NULL"),
    (r"_NOTHING", "_MEASUREMENT"),
    (r": ZERO;", ": (real)1;"),
]


DELETED = re.compile(
    r"\s+((s|tap)->[^;]*|(rest|quiet|latch|limit|ramp|advance|boundary)\([^;]*\)|waiting\(s\)->[^;]*|break"
    r"|crc \^=.*|met \|=.*);"
)


def guard_lines(code):
    """Return the numbers of the lines inside the guards' functions."""
    lines, inside, found = code.splitlines(), False, []
    for k, line in enumerate(lines):
        if not line.startswith((" ", "}", "{", "#", "/")) and "(" in line and not line.endswith(";"):
            inside = any(re.search(rf"(_|\b){name}\(", line) for name in GUARDS)
        if inside and line.startswith("    "):
            found.append(k)
    return found


def mutants(code):
    """Return (line number, line as it becomes) for every swap and every deleted statement."""
    lines = code.splitlines()
    made = []
    for k in guard_lines(code):
        line = lines[k]
        for pattern, other in SWAPS:
            changed = re.sub(pattern, other, line, count=1)
            if changed != line:
                made.append((k, changed))
        # A break deleted at the end of a switch, or before a default that does nothing, changes nothing.
        idle = "break" in line and lines[k + 1].strip().startswith(("}", "default"))
        if DELETED.fullmatch(line) and not idle:
            made.append((k, ""))
    return made


def passes(program):
    """Return whether the self-test ends well; one that crashes or hangs has been noticed."""
    try:
        return subprocess.run([program], capture_output=True, timeout=20, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def survivors(folder, cc, code, planted):
    """Return the planted faults that the folder's self-test does not notice."""
    flags = ["-std=c99", "-O0", "-w", "-ffp-contract=off"]
    test = ["-DCONTROLLER_MAIN", "-c", "controller_selftest.c", "-o", "selftest.o"]
    subprocess.run([cc, *flags, *test], cwd=folder, check=True)
    alive = []
    for k, line in planted:
        lines = code.splitlines()
        original, lines[k] = lines[k].strip(), line
        (folder / "mutant.c").write_text("\n".join(lines))
        words = [cc, *flags, "mutant.c", "selftest.o", "-o", "mutant"]
        refused = subprocess.run(words, cwd=folder, capture_output=True, check=False).returncode
        if not refused and passes(folder / "mutant"):
            alive.append(f"line {k + 1}: {original}  ->  {line.strip() or 'deleted'}")
    print(f"{len(planted)} faults planted, {len(alive)} unnoticed")
    return alive


def test_self_test_notices_planted_faults(law_of, rng, tmp_path, cc):
    generate(law_of(4, 3, 2), tmp_path / "code", limits_v=2.0, ramp_s=0.004)
    code = (tmp_path / "code" / "controller.c").read_text()
    every = mutants(code)
    drawn = [every[k] for k in rng.choice(len(every), 20, replace=False)]
    assert survivors(tmp_path / "code", cc, code, drawn) == []


@pytest.mark.slow
@pytest.mark.parametrize("ramp_s", [2 / 3500, 0.004, 0.05])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_self_test_notices_every_planted_fault(law_of, tmp_path, cc, precision, ramp_s):
    generate(law_of(5, 2, 3), tmp_path / "code", precision, limits_v=2.0, ramp_s=ramp_s, anti_windup=True)
    code = (tmp_path / "code" / "controller.c").read_text()
    every = mutants(code)
    assert len(every) >= 100
    assert survivors(tmp_path / "code", cc, code, every) == []
