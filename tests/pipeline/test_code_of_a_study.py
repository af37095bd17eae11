"""`[deploy]` of a study: whole numbers, the form, anti-windup, C31 assembly; report and summary say what was made."""

import json
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from small_study import STUDY, walk, written

import ultraquiet as uq
from read_page import Page
from ultraquiet.cli.exits.codes import exit_code
from ultraquiet.pipeline.facts.code import CodeFacts, DeploymentFacts, NoCode, WholeNumberFacts
from ultraquiet.pipeline.facts.loops import LoopFacts, UnstableLoop
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.making.code import deployed
from ultraquiet.pipeline.making.code import written as code_of
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.stages import Stages
from ultraquiet.pipeline.study import StudyError, load_study
from ultraquiet.pipeline.tables.code import Deploy

SCHEMA = Path(__file__).parents[2] / "docs" / "summary.schema.json"
LIMITS = np.array([[-1.0, 1.0]])
LAW = uq.StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
PLANT = uq.StateSpace([[0.5]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)


def study_with(folder, table):
    study = written(folder)
    study.write_text(STUDY + "[deploy]\n" + table)
    return study


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a study in whole numbers, and its report."""
    folder = tmp_path_factory.mktemp("whole")
    walk(study_with(folder, 'precision = "q31"\nrange = 20.0\n'), folder / "out", say=lambda _: None)
    return folder / "out", Page((folder / "out" / "report.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_study_deploys_whole_numbers_and_says_so(whole):
    folder, page = whole
    summary = json.loads((folder / "summary.json").read_text())
    jsonschema.validate(summary, json.loads(SCHEMA.read_text()))
    facts = from_plain(DeploymentFacts, summary["deployment"]["calm"])
    assert type(facts) is WholeNumberFacts
    assert (facts.precision, facts.bit_exact, facts.failed) == ("q31", True, False)
    assert "int32_t" in (folder / "code" / "calm" / "controller.c").read_text()
    (section,) = [s for s in page.sections if s.title == "Code"]
    table = section.table("Generated C99")
    row = dict(zip(table.heads, table.rows[0], strict=True))
    assert row["every bit that of its twin"] == "yes"
    assert row["multiplications and additions a sample"] == str(facts.multiply_adds)
    assert not [head for head in table.heads if "flash" in head or "C31" in head]
    assert section.table("Word lengths").rows[0][1] == "q31"
    assert "its code of whole numbers, q31, is ok" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_study_writes_c31_assembly_and_says_how_far_its_vectors_go(tmp_path):
    asked = Deploy(form="modal", targets=["c99", "c31"], anti_windup=True, processors=[])
    facts = deployed("calm", LAW, PLANT, LIMITS, tmp_path, asked, []).facts
    assert isinstance(facts, CodeFacts)
    assert (facts.form, facts.anti_windup) == ("modal", True)
    assert facts.c31_vectors == "every command meets both limits"
    assert facts.bit_exact_on in (None, {})
    assert (tmp_path / "calm" / "controller_c31.asm").exists()
    assert from_plain(DeploymentFacts, to_plain(facts)).c31_vectors == facts.c31_vectors


@pytest.mark.parametrize(("gain", "word"), [(1e-6, "ok"), (1e-3, "inexact")])
def test_code_that_rounding_changes_too_much_has_failed_as_for_deploy(gain, word, tmp_path):
    """Two poles within a millionth of one, in float32 as they stand."""
    A = [[1 - 1e-6, 1.0], [-1e-12, 1 - 1e-6]]
    law = uq.StateSpace(A, [[0.0], [1e-6]], [[-gain, 0.0]], [[0.0]], rate_hz=3500.0)
    facts = deployed("calm", law, PLANT, LIMITS, tmp_path, Deploy(form="dense", processors=[]), []).facts
    print(facts.status)
    assert facts.status.startswith(f"{word}: ")
    assert facts.verdict == (facts.verification if word == "ok" else facts.status)
    assert facts.failed is (word == "inexact")
    code = code_of(law, LIMITS, tmp_path / "code", Deploy(form="dense"), PLANT)
    assert exit_code(code.status) == int(facts.failed)


def test_whole_numbers_keep_to_the_least_of_the_limits(tmp_path):
    made = code_of(LAW, np.array([[-1.0, 3.0]]), tmp_path / "code", Deploy(precision="q15", range=10.0), PLANT)
    assert isinstance(made, uq.deploy.FixedDeployment)
    assert (made.law.output_v, made.law.input_v) == (1.0, 10.0)


def test_whole_numbers_without_a_range_are_refused_by_name_and_leave_the_study_standing(tmp_path):
    facts = deployed("calm", LAW, PLANT, LIMITS, tmp_path, Deploy(precision="q31"), []).facts
    assert isinstance(facts, NoCode)
    assert facts.failed
    assert "whole numbers need a range" in facts.status


@pytest.mark.gate("units1-True")
@pytest.mark.parametrize(
    ("units", "is_written"),
    [
        ({}, True),
        ({"bench": UnstableLoop(status="not known: Noise hides it.")}, True),
        ({"bench": UnstableLoop(status="unstable: A mode grows.")}, False),
    ],
)
def test_no_code_is_written_of_a_law_that_its_bench_does_not_bear(units, is_written, tmp_path):
    said = []
    channels = [uq.Channel("push", "N", -1.0, 1.0)]
    stages = SimpleNamespace(
        study=SimpleNamespace(deploy=Deploy(processors=[])),
        bench=SimpleNamespace(actuators=channels),
        records={},
        cache=Cache(tmp_path, said.append),
        say=said.append,
    )
    plan = SimpleNamespace(tones_hz=())
    facts = Stages._deploy(stages, "calm", LAW, PLANT, plan, False, Outcome({}, LoopFacts(units=units)))
    assert (tmp_path / "code" / "calm" / "controller.c").exists() is is_written
    assert facts.failed is not is_written
    if not is_written:
        assert said[-1] == "code of calm: refused: the loop is unstable on the bench; no code is written of it."


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('precision = "q31"\nanti_windup = true', "code in q31 has no anti-windup"),
        ('precision = "q15"\ntargets = ["c99", "c31"]', "no C31 assembly"),
        ('precision = "q31"\nprocessors = ["cortex-m7"]', "proved here only"),
        ('precision = "q31"\nform = "schur"', "modal and delta form"),
        ("anti_windup = 1", "'anti_windup' is 1; it is true, false or 'auto'"),
        ("range = 10.0", "takes any reading"),
        ('targets = ["c31"]', "must list 'c99'"),
        ('processors = ["z80"]', "one of cortex-m4f, cortex-m7"),
    ],
)
def test_what_does_not_go_together_is_refused_before_the_walk(tmp_path, table, said):
    with pytest.raises(StudyError, match=said):
        load_study(study_with(tmp_path, table + "\n"))
