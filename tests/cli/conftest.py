"""The command line as a user calls it, in a folder of its own."""

import sys

import pytest

from ultraquiet.cli.app import main


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run `ultraquiet WORDS` in `tmp_path`; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")

    def command(*words):
        capsys.readouterr()  # what the test itself has printed
        monkeypatch.setattr(sys, "argv", ["ultraquiet", *map(str, words)])
        try:
            main()
        except SystemExit as stop:
            return stop.code or 0, *capsys.readouterr()
        return 0, *capsys.readouterr()

    return command
