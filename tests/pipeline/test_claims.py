"""What a publication printed, claim by claim, beside the figures of this run, which are read from its summary."""

from types import SimpleNamespace

import pytest

from ultraquiet.pipeline import packaged_study
from ultraquiet.pipeline.report.claims import MISSING, _ours, at
from ultraquiet.pipeline.report.records import noted
from ultraquiet.pipeline.study import StudyError, parse
from ultraquiet.pipeline.tables.paper import Claim, Paper

FOUND = {"loops": {"calm": {"tones": {"2.5": {"reduction_db": 12.345}}}}, "bands": [{"db": 3}], "ok": True}


@pytest.mark.parametrize(
    ("place", "value"),
    [("loops/calm/tones/2.5/reduction_db", 12.345), ("bands/0/db", 3), ("bands/1/db", None), ("loops/wild", None)],
)
def test_a_place_is_found_or_not(place, value):
    assert at(place, FOUND) == value


def test_figures_stand_with_their_labels_and_what_is_not_there_is_said():
    ours = {"tone": "loops/calm/tones/2.5/reduction_db", "other": "loops/wild", "word": "ok"}
    claim = Claim(where="Fig. 1", printed="13 dB", ours=ours, unit="dB")
    assert _ours(claim, FOUND) == f"tone: 12.3 dB; other: {MISSING}; word: True"
    assert _ours(Claim(where="Fig. 2", printed="a curve"), FOUND) == "-"


def test_the_packaged_claims_name_what_the_study_has():
    study = packaged_study("suite")
    assert len(study.paper.claims) >= 9
    for claim in study.paper.claims:
        assert claim.where
        assert claim.why
        for place in claim.ours.values():
            root, *names = place.split("/")
            if root in ("closed_loop", "design", "deployment", "payload"):
                assert names[0] in study.controllers, place
            if "tones" in names:
                assert float(names[names.index("tones") + 1]) in study.closed_loop.tones_hz, place


def test_nothing_of_a_paper_is_known_beyond_its_table():
    bare = Paper(records=["noise"])
    assert (bare.band_hz, bare.figures, bare.zeros, bare.counts_plant, bare.processor) == (None, {}, "", False, None)
    result = SimpleNamespace(study=SimpleNamespace(paper=bare))
    assert not noted(result, "bode")
    result.study.paper = bare.model_copy(update={"figures": {"bode": "plate 7"}})
    assert noted(result, "bode") == " (Paper: plate 7.)"
    assert not noted(result, "excitation")


def test_a_claim_is_checked_with_its_line():
    text = """[study]
title = "a"
[bench]
method = "hexapod"
[plant]
method = "subspace"
records = ["all"]
order = 4
[controllers.calm.design]
method = "lqg"
[paper]
records = ["all"]
[[paper.claims]]
where = "Fig. 1"
wy = "so"
"""
    with pytest.raises(StudyError) as refused:
        parse(text)
    told = dict(refused.value.mistakes)
    assert "did you mean 'why'" in told[15]
    assert any("'printed' is missing" in sentence for sentence in told.values())
