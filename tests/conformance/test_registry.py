"""Every registered method keeps its family's promises; registering it is all it takes to be checked here."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ultraquiet._base import registry
from ultraquiet._base.errors import UnknownMethodError
from ultraquiet.reduce import Balanced
from ultraquiet.testing import check
from ultraquiet.values import StateSpace

ENTRIES = [(family, name) for family in registry.FAMILIES for name in registry.methods(family)]
PLANT = Path(__file__).parents[2] / "docs" / "examples" / "plant.py"
TONE = {"tones_hz": (30.0,)}
NEEDS_SETTINGS = {  # they wrap what the caller has, or work against what he names
    ("bench", "wrapped"): {
        "step": lambda u, d: 2.0 * (u + d),
        "reset": lambda: None,
        "rate_hz": 100.0,
        "actuators": ["force"],
        "sensors": ["speed"],
    },
    ("bench", "process"): {"command": (sys.executable, str(PLANT))},
    ("design", "resonators"): TONE,
    ("design", "adaptive-feedforward"): TONE,
    ("design", "youla-kucera"): TONE,
}
# A recording answers no signal but its own; an FMU must be built first, by tests/bench/test_fmu_bench.py.
TESTED_ELSEWHERE = {("bench", "replay"), ("bench", "fmu")}
# They search for seconds each.
LONG = {
    ("identify", "structured"),
    ("identify", "structured-modal"),
    ("design", "fixed-structure"),
    ("design", "peak-bounded"),
    ("design", "mu-synthesis"),
}
CHECKED = [
    pytest.param(*entry, marks=[pytest.mark.slow] if entry in LONG else [])
    for entry in ENTRIES
    if entry not in TESTED_ELSEWHERE
]


@pytest.mark.parametrize(("family", "name"), CHECKED)
def test_method_keeps_its_promises(family, name, seed):
    check(family, name, seed, **NEEDS_SETTINGS.get((family, name), {}))


@pytest.mark.parametrize("family", registry.FAMILIES)
def test_family_is_listed_by_the_command_line(family):
    from ultraquiet.cli.app import app

    printed = CliRunner(env={"COLUMNS": "240"}).invoke(app, ["methods", family])
    assert printed.exit_code == 0
    for name in registry.methods(family):
        assert name in printed.stdout


def test_unknown_names_are_refused_with_what_there_is():
    with pytest.raises(UnknownMethodError, match="chirp"):
        registry.lookup("signals", "chrip")
    with pytest.raises(UnknownMethodError, match="signals"):
        registry.methods("signal")


def keep_first(result, law, n):
    return replace(result, controller=StateSpace(law.A[:n, :n], law.B[:n], law.C[:, :n], law.D, law.rate_hz))


def turn_sign(result, law, n):
    r = result.controller
    return replace(result, controller=StateSpace(r.A, r.B, -r.C, r.D, r.rate_hz))


def brag(result, law, n):
    return replace(result, details={"bound": result.details["bound"] / 100})


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [(keep_first, "hardly matters"), (turn_sign, "hardly matters"), (brag, "promised an error")],
)
def test_a_careless_reduction_is_caught(spoil, complaint, seed):
    @dataclass(frozen=True)
    class Careless(Balanced):
        """Balanced reduction, spoilt."""

        def reduce(self, controller, plant=None, weights=None):
            return spoil(super().reduce(controller, plant, weights), controller, self.states)

    with (
        registry.registered("reduce", "careless-for-test", Careless),
        pytest.raises(AssertionError, match=complaint),
    ):
        check("reduce", "careless-for-test", seed)


def test_a_new_method_appears_by_registering():
    @dataclass(frozen=True)
    class Silence:
        """Nothing at all."""

        def generate(self, samples, rate_hz, seed=0):
            raise NotImplementedError

    with registry.registered("signals", "silence-for-test", Silence):
        assert registry.lookup("signals", "silence-for-test") is Silence
        with pytest.raises(UnknownMethodError, match="taken"):
            registry.register("signals", "silence-for-test")(type("Other", (), {"generate": None}))
    assert "silence-for-test" not in registry.methods("signals")


def test_no_test_leaves_a_method_of_its_own():
    """What a file of tests registers as it is imported would be among the methods of all others."""
    tests = Path(__file__).parents[1]
    for family in registry.FAMILIES:
        for name, method in registry.methods(family).items():
            file = getattr(sys.modules[method.__module__], "__file__", None)
            assert file is None or not Path(file).is_relative_to(tests), f"{family} {name}"
