"""The shipped self-test must notice every fault planted in the guards of the generated code."""

import re
import subprocess

import pytest

from ultraquiet.deploy import generate

GUARDS = (
    "finite_all",
    "rest",
    "init",
    "enable",
    "disable",
    "clear",
    "frame",
    "latch",
    "law",
    "limit",
    "ramp",
    "output",
    "update",
    "read",
)

SWAPS = [
    (r"==", "!="),
    (r"!=", "=="),
    (r">= -REAL_MAX", ">= REAL_MAX"),
    (r"<= REAL_MAX", "<= -REAL_MAX"),
    (r" < LIMIT", " > LIMIT"),
    (r" > LIMIT", " < LIMIT"),
    (r"\[0\]\) \{", "[1]) {"),
    (r"LIMIT\[i\]\[1\];", "LIMIT[i][0];"),
    (r"&&", "||"),
    (r"\|\|", "&&"),
    (r"\+ 1U", "+ 2U"),
    (r"- 1U", "- 2U"),
    (r"= 1U;", "= 0U;"),
    (r"= 0U;", "= 1U;"),
    (r"return true;", "return false;"),
    (r"return false;", "return true;"),
    (r"met = true;", "met = false;"),
    (r"< UINT32_MAX", "<= UINT32_MAX"),
    (r"_RAMP_STEPS\)", "_RAMP_STEPS - 1U)"),
    (r"\|= fault", "= 0U * fault"),
    (r"_FAULT;", "_STOPPING;"),
    (r"_FAULT_INPUT\)", "_FAULT_OUTPUT)"),
    (r"_FAULT_OUTPUT\)", "_FAULT_INPUT)"),
    (r"_ON;", "_OFF;"),
    (r"_OFF;", "_ON;"),
    (r"_STOPPING;", "_OFF;"),
    (r"!finite_all", "finite_all"),
    (r"\* RAMP_STEP", "* (real)1"),
    (r"s->on_overrun = on_overrun", "s->on_overrun = 0"),
    (r"= on_overrun;", "= 0;"),
    (r"= \(real\)0;", "= (real)1;"),
    (r"i < NU", "i < NU - 1U"),
    (r"j < NY", "j < NY - 1U"),
    (r"i < NX", "i < NX - 1U"),
    (r"i < count", "i + 1U < count"),
]


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
        if re.fullmatch(
            r"\s+(s->[^;]*|rest\(s\)|latch\([^;]*\)|limit\(s\)|ramp\(s\)|advance\(s\)|v = [^;]*|tap->[^;]*);", line
        ):
            made.append((k, ""))
    return made


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
        subprocess.run([cc, *flags, "mutant.c", "selftest.o", "-o", "mutant"], cwd=folder, check=True)
        if subprocess.run([folder / "mutant"], capture_output=True, timeout=20, check=False).returncode == 0:
            alive.append(f"line {k + 1}: {original}  ->  {line.strip() or 'deleted'}")
    print(f"{len(planted)} faults planted, {len(alive)} unnoticed")
    return alive


def test_self_test_notices_planted_faults(law_of, rng, tmp_path, cc):
    generate(law_of(4, 3, 2), tmp_path / "code", limits_v=2.0, ramp_s=0.004)
    code = (tmp_path / "code" / "controller.c").read_text()
    every = mutants(code)
    drawn = [every[k] for k in rng.choice(len(every), 40, replace=False)]
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
