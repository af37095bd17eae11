"""The generated code in the eyes of a checker of the MISRA C:2012 rules, where one is installed."""

import re
import shutil
import subprocess

import pytest

from ultraquiet.deploy import generate
from ultraquiet.deploy.c_code.render import DEVIATIONS

STRICT = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror", "-Wstrict-prototypes", "-Wundef")


@pytest.mark.gate("modal")
@pytest.mark.parametrize("form", ["modal", "schur"])
def test_checker_finds_no_rule_broken_but_the_accepted(law_of, tmp_path, form):
    checker = shutil.which("cppcheck")
    if checker is None:
        pytest.skip("cppcheck is not installed")
    generate(law_of(8), tmp_path / "code", form=form, anti_windup=True)
    command = [checker, "--enable=style,warning,portability", "--std=c99", "--addon=misra", "controller.c"]
    told = subprocess.run(command, cwd=tmp_path / "code", capture_output=True, text=True, timeout=120, check=False)
    if "Did not find addon" in told.stdout + told.stderr or "misra" not in told.stderr:
        pytest.skip(f"cppcheck without its MISRA addon: {told.stdout[:80]}")
    broken = set(re.findall(r"misra-c2012-([\d.]+)\]", told.stderr))
    others = [line for line in told.stderr.splitlines() if re.search(r"(error|warning|portability):", line)]
    print(f"rules departed from: {sorted(broken)}")
    assert broken <= set(DEVIATIONS), told.stderr
    assert not others
    readme = (tmp_path / "code" / "README.md").read_text()
    assert all(f"* Rule {rule}: " in readme for rule in DEVIATIONS)


@pytest.mark.gate("modal-float32")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("form", ["modal", "delta", "schur", "dense"])
def test_compilers_warn_of_nothing(law_of, tmp_path, form, precision):
    compilers = [p for p in map(shutil.which, ("gcc", "clang", "arm-none-eabi-gcc")) if p]
    if not compilers:
        pytest.skip("neither gcc nor clang is installed")
    made = generate(law_of(7), tmp_path / "code", precision, form=form, anti_windup=True)
    for cc in compilers:
        for source in ("controller.c", "controller_selftest.c", "controller_host.c"):
            command = [cc, "-std=c99", "-O2", *STRICT, "-c", source, "-o", "made.o"]
            told = subprocess.run(command, cwd=made.folder, capture_output=True, text=True, timeout=60, check=False)
            assert told.returncode == 0, told.stderr
            assert not told.stderr
    print(f"{form} {precision}: no warning from {len(compilers)} compilers with {' '.join(STRICT)}")
