"""How draws are judged: a count that the stated rates explain passes, one that they do not fails; and draws repeat."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from fresh_draws import Outcome, results, too_many

TESTS = Path(__file__).parents[1]


def outcome(rate, draws, failures):
    return Outcome(rate, draws, list(range(failures)))


def test_what_states_no_rate_may_not_fail():
    assert too_many({"a": outcome(0.0, 5, 0)}) == []
    assert "states no rate" in too_many({"a": outcome(0.0, 5, 1)})[0]


@pytest.mark.parametrize(("failures", "allowed"), [(0, True), (1, True), (2, False), (5, False)])
def test_a_stated_rate_allows_what_chance_brings(failures, allowed):
    """Of five draws at 2 % one failure has a chance of 10 %, two have one of 0.4 %."""
    assert (too_many({"a": outcome(0.02, 5, failures)}) == []) == allowed


def test_many_rare_failures_add_up():
    """Twenty tests at 0.1 % over five draws: one failure has a chance of 10 %, two of 0.5 %."""
    one = {str(k): outcome(1e-3, 5, int(k < 1)) for k in range(20)}
    two = {str(k): outcome(1e-3, 5, int(k < 2)) for k in range(20)}
    assert too_many(one) == []
    assert "2 failures of tests that state rates" in too_many(two)[-1]


def test_the_cheap_files_are_there():
    """A file that was renamed would lose two of its draws without a word."""
    # By its path: other folders have a conftest of their own, and whichever was imported first has the name.
    cheap = runpy.run_path(str(TESTS / "conftest.py"))["THREE_DRAWS"]
    assert [name for name in cheap if not (TESTS.parent / name).exists()] == []


SUITE = """
import pytest
from hypothesis import given, strategies as st


@pytest.mark.three_draws
def test_draws(seed, rng):
    print("DRAWN", seed, rng.integers(2**31))
    assert seed % 2


@pytest.mark.draws(false_alarm=0.25)
def test_states(seed):
    pass


def test_draws_nothing():
    pass


@pytest.mark.gate("a")
@pytest.mark.parametrize("case", ["a", "b"])
def test_cases(case):
    pass


@given(st.integers(0, 10**9))
def test_examples(number):
    print("EXAMPLE", number)
"""


CASES = ("test_cases[a]", "test_cases[b]")


@pytest.fixture
def suite(tmp_path):
    """A small suite under the same conftest; returns a run of it and the results it left."""
    (tmp_path / "conftest.py").write_text((TESTS / "conftest.py").read_text())
    (tmp_path / "test_small.py").write_text(SUITE)
    marks = "markers =\n    three_draws\n    slow\n    gate\n    draws(false_alarm)"
    (tmp_path / "pytest.ini").write_text(f"[pytest]\naddopts = --strict-markers -p no:cacheprovider\n{marks}\n")

    def run(*words):
        report = tmp_path / "out.xml"
        command = [sys.executable, "-m", "pytest", "-q", "-s", f"--junitxml={report}", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        said = [line for line in done.stdout.splitlines() if "DRAWN" in line or "EXAMPLE" in line]
        return {name: (rate, failed) for name, rate, failed in results(report)}, said, done.stdout

    return run


def test_the_gate_runs_the_same_cases_on_seeds_one_to_three(suite):
    found, said, _ = suite()
    again, said_again, _ = suite()
    drawn = {f"test_small.py::test_draws[seed{k}]": (0.0, k == 2) for k in (1, 2, 3)}
    rest = {"test_small.py::test_states[seed1]": (0.25, False)}
    rest |= {f"test_small.py::{name}": (0.0, False) for name in ("test_draws_nothing", "test_examples", *CASES)}
    assert found == again == drawn | rest
    assert said == said_again
    assert len(said) > 50


@pytest.mark.slow
def test_a_seed_that_is_given_is_drawn_from_and_repeats(suite):
    found, said, printed = suite("--drawing", "--seed", "8")
    assert sorted(found) == [
        f"test_small.py::{name}" for name in ("test_draws[drawn]", "test_examples", "test_states[drawn]")
    ]
    assert found["test_small.py::test_draws[drawn]"] == (0.0, True)
    assert "python -m pytest 'test_small.py::test_draws[drawn]' --seed 8" in printed
    assert suite("--drawing", "--seed", "8")[1] == said
    assert suite("--drawing", "--seed", "9")[1] != said


def test_a_case_that_the_gate_leaves_out_runs_where_it_is_named(suite):
    found, _, _ = suite("test_small.py::test_cases[b]")
    assert found == {"test_small.py::test_cases[b]": (0.0, False)}
