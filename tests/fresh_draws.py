"""Repeat the tests that draw on fresh seeds, print every failure with the seed that repeats it, and judge the count.

    python tests/fresh_draws.py [--draws 5] [words for pytest]

A test without a stated rate may not fail at all. A statistical test states how often it fails although nothing is
wrong, `@pytest.mark.draws(false_alarm=1e-3)`; it fails here when so many failures, of that test or of all of them
together, have a chance below LEVEL.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

ROOT = Path(__file__).parents[1]
LEVEL = 0.01  # chance that this judgement itself is a false alarm, once for single tests and once for their sum
RAN = (0, 1)  # pytest's exit codes of a run that went through


@dataclass
class Outcome:
    """What one test did over the draws."""

    rate: float = 0.0
    draws: int = 0
    failed_on: list[int] = field(default_factory=list)


def results(path: Path) -> list[tuple[str, float, bool]]:
    """Name, stated rate and failure of each test in a JUnit file; what was skipped has not drawn."""
    rows = []
    for case in ElementTree.parse(path).iter("testcase"):
        said = {p.get("name"): p.get("value") for p in case.iter("property")}
        if "nodeid" in said and case.find("skipped") is None:
            failed = case.find("failure") is not None or case.find("error") is not None
            rows.append((said["nodeid"], float(said.get("false_alarm", 0.0)), failed))
    return rows


def too_many(outcomes: dict[str, Outcome], level: float = LEVEL) -> list[str]:
    """Why the failures are more than the stated rates allow; empty when they are not.

    Each test's count is binomial; the sum over tests, rare and independent, is Poisson's (Le Cam 1960, error below
    the sum of squared rates). The level is shared by the tests that state a rate (Bonferroni).
    """
    from scipy.stats import binom, poisson

    stated = {name: o for name, o in outcomes.items() if o.rate > 0}
    reasons = [f"{name} states no rate and failed" for name, o in outcomes.items() if o.failed_on and not o.rate]
    for name, o in stated.items():
        failures = len(o.failed_on)
        if failures and binom.sf(failures - 1, o.draws, o.rate) < level / len(stated):
            reasons.append(f"{name} failed {failures} times in {o.draws} draws, it states a rate of {o.rate:g}")
    total, expected = sum(len(o.failed_on) for o in stated.values()), sum(o.draws * o.rate for o in stated.values())
    if total and poisson.sf(total - 1, expected) < level:
        reasons.append(f"{total} failures of tests that state rates, {expected:.2g} are expected of all of them")
    return reasons


def draw(seed: int, words: list[str], folder: Path) -> tuple[int, Path]:
    """One run of every test that draws."""
    report = folder / f"{seed}.xml"
    command = ["-m", "pytest", "-q", "--drawing", "--seed", str(seed), f"--junitxml={report}", *words]
    return subprocess.run([sys.executable, *command], cwd=ROOT, check=False, env=os.environ).returncode, report


def main() -> int:
    """Draw, count, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--draws", type=int, default=5)
    known, words = parser.parse_known_args()
    outcomes: dict[str, Outcome] = {}
    broken = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(known.draws):
            seed = int(np.random.SeedSequence().generate_state(1)[0])
            print(f"\ndraw {k + 1} of {known.draws}: --seed {seed}", flush=True)
            code, report = draw(seed, words, Path(folder))
            if code not in RAN:
                broken.append(f"--seed {seed}: pytest ended with exit code {code}")
                continue
            for name, rate, failed in results(report):
                one = outcomes.setdefault(name, Outcome(rate))
                one.draws += 1
                if failed:
                    one.failed_on.append(seed)
    print(f"\n{len(outcomes)} tests that draw, {known.draws} draws")
    for name, one in outcomes.items():
        for seed in one.failed_on:
            print(f"failed: python -m pytest '{name}' --seed {seed}")
    reasons = [*broken, *too_many(outcomes)]
    print("\n".join(reasons) if reasons else "no more failures than the stated rates allow")
    return bool(reasons)


if __name__ == "__main__":
    sys.exit(main())
