"""Lines, branches and MC/DC of the generated code under its own self-test, measured by a compiler that counts them.

`test_deploy_compilers` derives MC/DC from gcov's branches of conditions, which any gcc has; clang from 18 on and gcc
from 14 on count independent effects themselves.
"""

import functools
import json
import re
import subprocess

import numpy as np
import pytest
from compilers_here import versions
from deploy_laws import RANGES, RATE_HZ, block, law_in_words, random_law

from ultraquiet.deploy import generate, generate_fixed
from ultraquiet.values import StateSpace

SOURCES = ("controller.c", "controller_selftest.c")
FLAGS = ("-std=c99", "-O0", "-w", "-DCONTROLLER_MAIN")


def said_by(folder, *command, **environment):
    """Return what a program prints; it must end well."""
    told = subprocess.run(command, cwd=folder, env=environment or None, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr[-500:]
    return told.stdout


@functools.cache
def tool():
    """Return the programs that measure MC/DC: clang with its two tools, gcc with its one, or None."""
    for found in versions("clang", "llvm-profdata", "llvm-cov", oldest=18):
        if "-fcoverage-mcdc" in said_by("/", found[0], "--help-hidden"):
            return "clang", found
    for found in versions("gcc", "gcov", oldest=14):
        if "-fcondition-coverage" in said_by("/", found[0], "--help=common"):
            return "gcc", found
    return None


def by_clang(folder, clang, profdata, cov):
    """Return (covered, of how many) for lines, branches and conditions."""
    counted = ("-fprofile-instr-generate", "-fcoverage-mapping", "-fcoverage-mcdc")
    said_by(folder, clang, *FLAGS, *counted, *SOURCES, "-o", "covered")
    said_by(folder, "./covered", LLVM_PROFILE_FILE="covered.raw")
    said_by(folder, profdata, "merge", "covered.raw", "-o", "covered.profile")
    words = ("export", "-summary-only", "-instr-profile=covered.profile", "./covered", SOURCES[0])
    totals = json.loads(said_by(folder, cov, *words))["data"][0]["totals"]
    return [(totals[what]["covered"], totals[what]["count"]) for what in ("lines", "branches", "mcdc")]


def by_gcc(folder, gcc, gcov):
    """Return the same; gcc counts both outcomes of each condition."""
    said_by(folder, gcc, *FLAGS, "--coverage", "-fcondition-coverage", *SOURCES, "-o", "covered")
    said_by(folder, "./covered")
    told = said_by(folder, gcov, "-b", "-c", "--conditions", "covered-controller.gcda")
    part = told.partition(f"File '{SOURCES[0]}'")[2]
    heads = ("Lines executed", "Taken at least once", "Condition outcomes covered")
    found = [re.search(rf"{head}:([\d.]+)% of (\d+)", part) for head in heads]
    return [(round(float(m[1]) * int(m[2]) / 100), int(m[2])) if m else (0, 0) for m in found]


def measured(folder):
    """Return the coverage of a folder's code, or skip where nothing can count it."""
    found = tool()
    if found is None:
        pytest.skip("neither clang 18 with llvm-cov nor gcc 14 with gcov, which count MC/DC, is installed")
    return (by_clang if found[0] == "clang" else by_gcc)(folder, *found[1])


def banked(rng, channels):
    """Return a decentralised law: a few blocks from each measurement to the command of the same number."""
    poles = np.exp(2 * np.pi * rng.uniform(5.0, 400.0, sum(channels)) * (-0.1 + 1j) / RATE_HZ)
    own = np.repeat(np.arange(len(channels)), 2 * np.array(channels))[:, None] == np.arange(len(channels))
    A = np.zeros((len(own), len(own)))
    for k, pole in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block(pole)
    B, C = (0.3 * rng.standard_normal(own.shape) * own for _ in range(2))
    return StateSpace(A, B, C.T, np.diag(rng.standard_normal(len(channels))), rate_hz=RATE_HZ)


def one_state(pole=0.9, through=0.3):
    return StateSpace([[pole]], [[0.2]], [[0.5]], [[through]], rate_hz=RATE_HZ)


# Sizes and settings in which a decision might have nothing to decide: one channel, one step of ramp, one overrun,
# limits of one side, commands that never move.
FLOATING = {
    "modal": (lambda rng: random_law(rng, 7, 3, 2), {"form": "modal", "anti_windup": True}),
    "delta": (lambda rng: random_law(rng, 6, 1, 4), {"form": "delta"}),
    "bank": (lambda rng: banked(rng, (2, 0, 1)), {"form": "bank", "anti_windup": True}),
    "bank-delta": (lambda rng: banked(rng, (1, 1)), {"form": "bank-delta", "precision": "float64"}),
    "schur": (lambda rng: random_law(rng, 7, 2, 2), {"form": "schur", "anti_windup": True}),
    "dense": (lambda rng: random_law(rng, 5, 6, 6), {"form": "dense", "precision": "float64"}),
    "one": (lambda _: one_state(), {}),
    "one step of ramp": (lambda _: one_state(), {"ramp_s": 1 / RATE_HZ, "overrun_limit": 1}),
    "millions of overruns": (lambda rng: random_law(rng, 4, 2, 2), {"overrun_limit": 2**24}),
    "one side": (lambda rng: random_law(rng, 4, 2, 2), {"limits_v": [[0.0, 5.0], [-3.0, 0.0]]}),
    "no limit": (lambda rng: random_law(rng, 4, 2, 3), {"form": "modal", "anti_windup": True}),
    "no command": (lambda _: StateSpace([[0.9]], [[1.0]], [[0.0]], [[0.0]], rate_hz=RATE_HZ), {"form": "modal"}),
    "no state": (lambda _: StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], RATE_HZ), {}),
}
WHOLE = {
    f"{word} {scaling} {form}": (word, {"scaling": scaling, "form": form})
    for word in ("q15", "q31")
    for scaling in ("l1", "l2")
    for form in ("modal", "delta")
}


def judged(name, folder):
    (lines, of_lines), (branches, of_branches), (conditions, of_conditions) = measured(folder)
    print(
        f"{name}, counted by {tool()[0]}: {lines} of {of_lines} lines, {branches} of {of_branches} branches, MC/DC of"
        f" {conditions} of {of_conditions} conditions"
    )
    assert of_lines > 0
    assert of_branches > 0
    assert of_conditions > 0
    assert (lines, branches, conditions) == (of_lines, of_branches, of_conditions)


@pytest.mark.gate("modal")
@pytest.mark.parametrize("case", FLOATING)
def test_mcdc_of_the_code_under_its_self_test(rng, tmp_path, case):
    law, settings = FLOATING[case]
    generate(law(rng), tmp_path / "code", **{"ramp_s": 0.01, **settings})
    judged(case, tmp_path / "code")


@pytest.mark.gate("q15 l2 modal")
@pytest.mark.parametrize("case", WHOLE)
def test_mcdc_of_whole_number_code_under_its_self_test(rng, tmp_path, case):
    word, settings = WHOLE[case]
    law = law_in_words(rng, word, 6, 2, 2, quiet=1e-3, drowned=False, **settings)
    quiet = StateSpace(law.A, law.B, 1e-3 * law.C, 1e-3 * law.D, rate_hz=RATE_HZ)
    for loudness, controller in (("as it is", law), ("a thousandth", quiet), ("one state", one_state())):
        folder = tmp_path / loudness.replace(" ", "_")
        generate_fixed(controller, folder, word, tolerance=1.0, ramp_s=0.02, **RANGES, **settings)
        judged(f"{case}, {loudness}", folder)
