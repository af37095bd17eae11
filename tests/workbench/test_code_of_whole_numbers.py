"""A law as code of whole numbers: made on the boards, kept in the study, and made again by the script."""

import json

from workbench_helpers import finished_study

from ultraquiet.pipeline.study import parse
from ultraquiet.workbench import Session


def test_whole_numbers_are_made_kept_and_written(tmp_path, monkeypatch):
    session = Session(finished_study(tmp_path / "study", 1, 1))
    session.do({"op": "table", "table": "deploy", "values": {"precision": "q31", "range": 4.0, "form": "modal"}})
    made = session.make("codes", "quiet")
    assert made.facts["code"]["precision"] == "q31"
    assert made.facts["code"]["bit_exact"] is True
    assert parse(session.toml()).deploy.range == 4.0
    (line,) = (line for line in session.python().splitlines() if line.startswith("code_"))
    assert ".generate_fixed(" in line
    assert "input_v=4.0" in line
    assert "form='modal'" in line
    monkeypatch.chdir(session.folder)
    found = {}
    exec(session.python(), found)
    (code,) = (value for name, value in found.items() if name.startswith("code_"))
    assert code.law.hash == made_hash(made)


def made_hash(item):
    """The hash of the coefficients that the code on the board was made with."""
    (manifest,) = item.folder.rglob("manifest.json")
    return json.loads(manifest.read_text())["coefficients_sha256"]
