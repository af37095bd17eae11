"""Every registered method keeps its family's promises; registering it is all it takes to be checked here."""

import pytest
from typer.testing import CliRunner

from ultraquiet._base import registry
from ultraquiet._base.errors import UnknownMethodError
from ultraquiet.testing import check

ENTRIES = [(family, name) for family in registry.FAMILIES for name in registry.methods(family)]
NEEDS_SETTINGS = {("bench", "replay"), ("bench", "wrapped")}  # they wrap what the caller has


@pytest.mark.parametrize(("family", "name"), [e for e in ENTRIES if e not in NEEDS_SETTINGS])
def test_method_keeps_its_promises(family, name, seed):
    check(family, name, seed)


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


def test_a_new_method_appears_by_registering():
    from dataclasses import dataclass

    @registry.register("signals", "silence-for-test")
    @dataclass(frozen=True)
    class Silence:
        """Nothing at all."""

        def generate(self, samples, rate_hz, seed=0):
            raise NotImplementedError

    try:
        assert registry.lookup("signals", "silence-for-test") is Silence
        with pytest.raises(UnknownMethodError, match="taken"):
            registry.register("signals", "silence-for-test")(type("Other", (), {"generate": None}))
    finally:
        registry._table["signals"].pop("silence-for-test")
