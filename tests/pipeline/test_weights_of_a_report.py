"""A report shows what a cost puts on S, T and KS, of the laws that have it, and the words that code computes in."""

import json

import numpy as np
import pytest
from small_study import STUDY, walk, written

import ultraquiet as uq
from read_page import Page
from ultraquiet.pipeline.facts.code import CodeFacts
from ultraquiet.pipeline.facts.typed import from_plain

pytestmark = pytest.mark.slow  # a study of three laws, walked to its report
WEIGHED = """
[controllers.shaped.design]
method = "mixed-sensitivity"
form = "skst"
band_hz = [20.0, 60.0]
height = 2.0
[controllers.fewer.design]
method = "mixed-sensitivity"
form = "skst"
band_hz = [20.0, 60.0]
height = 2.0
[controllers.fewer.reduce]
method = "balanced"
states = 4
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a study of three laws, two of them with weights, and its report."""
    folder = tmp_path_factory.mktemp("weights")
    study = written(folder)
    study.write_text(STUDY.replace("[closed_loop]", WEIGHED + "[closed_loop]"))
    walk(study, folder / "out", say=lambda _: None)
    return folder / "out", Page((folder / "out" / "report.html").read_text(encoding="utf-8"))


def test_weights_stand_over_the_loops_of_laws_that_have_them(made):
    _, page = made
    (section,) = [s for s in page.sections if s.title == "Design"]
    said = dict(zip(section.figures, section.captions, strict=True))["weights"]
    print(said)
    assert "shaped is nearest in " in said
    assert "fewer is nearest in " in said
    assert "Of calm nothing is drawn: an LQG cost is a mean square over all frequencies" in said


def test_the_caption_is_true_of_the_weights_that_the_study_left(made):
    folder, page = made
    design = json.loads((folder / "stages" / "design-shaped.json").read_text())["facts"]
    assert design["weights_on"] == ["S", "T", "KS"]
    G, K = (uq.files.load(folder / where) for where in ("models/plant.h5", "controllers/shaped.h5"))
    f = np.geomspace(0.5, 249.0, 20000)
    g, k = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (G, K))
    S = np.linalg.inv(np.eye(2) - g @ k)
    made_of = {"S": S, "T": S - np.eye(2), "KS": k @ S}
    over = {}
    for name, values in made_of.items():
        W = uq.files.load(folder / "controllers" / f"shaped+weight-{name}.h5").frequency_response(f)
        weighted = np.einsum("ijf,fjk->fik", W, values)
        over[name] = 20 * np.log10(np.linalg.norm(weighted, 2, axis=(1, 2)).max() / design["achieved"])
    nearest = max(over, key=over.get)
    caption = next(c for s in page.sections for n, c in zip(s.figures, s.captions, strict=True) if n == "weights")
    print(over, caption)
    assert f"shaped is nearest in {nearest}, {abs(over[nearest]):.1f} dB below" in caption


def test_word_lengths_stand_beside_the_code(made):
    folder, page = made
    (section,) = [s for s in page.sections if s.title == "Code"]
    table = section.table("Word lengths")
    reduced = [t for t in section.tables if t.caption.startswith("What each reduction left")]
    assert ("stands beside it" in " ".join(section.paragraphs)) == bool(reduced)
    summary = json.loads((folder / "summary.json").read_text())["deployment"]
    assert {row[0] for row in table.rows} == set(summary) == {"calm", "shaped", "fewer"}
    for row in table.rows:
        facts = from_plain(CodeFacts, summary[row[0]])
        cells = dict(zip(table.heads, row, strict=True))
        assert cells["number format"] == "float32"
        assert cells["coefficients, states, sums, readings and commands"] == "32 bits, 24 significant"
        assert cells["coefficients (bytes)"] == str(4 * facts.coefficients)
        assert len(facts.word_formats) == 4
