"""The generated code in the eyes of a checker of the MISRA C:2012 rules, where one is installed."""

import re
import shutil
import subprocess

import pytest

from ultraquiet.deploy import generate

# Advisory rules the code departs from on purpose: 15.5 one exit a function (guards leave early), 8.9 tables at block
# scope (they have a header of their own).
ACCEPTED = {"15.5", "8.9"}


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
    assert broken <= ACCEPTED, told.stderr
    assert not others
