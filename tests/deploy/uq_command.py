"""`ultraquiet WORDS` as a user calls it: exit code, stdout and stderr in one line each."""

import pytest

from ultraquiet.cli.app import main


def called(monkeypatch, capsys, *words):
    """Run the command; return its exit code and what it said."""
    monkeypatch.setattr("sys.argv", ["ultraquiet", *map(str, words)])
    monkeypatch.setenv("COLUMNS", "200")
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    return ended.value.code or 0, said.out, said.err
