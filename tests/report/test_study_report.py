"""The report of the embedded study: every section is there, and its tables are the numbers of `summary.json`."""

import json
import re
from html import unescape

import pytest

from raw_words import raw_words
from read_page import Page
from ultraquiet.deploy.figures import figure_text, figure_words

pytestmark = pytest.mark.web
SECTIONS = [
    "Excitation",
    "Response",
    "Identification",
    "Validation",
    "Analysis",
    "Limits",
    "Design",
    "Code",
    "Closed loop",
    "Payload",
    "The paper, claim by claim",
    "Provenance",
]


@pytest.fixture(scope="module")
def page(demo):
    return Page((demo[0] / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def summary(demo):
    return json.loads((demo[0] / "summary.json").read_text())


def rows(table):
    return {row[0]: dict(zip(table.heads, row, strict=True)) for row in table.rows}


def same(cell, value, digits):
    """Whether a cell is the number, to the digits that are shown; a missing number is a dash."""
    if value is None:
        return cell == "-"
    return float(cell) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits), abs=1e-12)


def tenth(cell, value):
    return cell == "-" if value is None else abs(float(cell) - value) <= 0.05 + 1e-9


def test_every_section_is_there_and_linked(page):
    assert [s.title for s in page.sections] == SECTIONS
    assert [name for _, name in page.links] == SECTIONS
    for section in page.sections:
        assert section.paragraphs or section.tables or section.figures, section.title


def test_it_says_which_run_it_was(page, summary):
    assert page.title == summary["title"]
    assert page.facts["seed"] == str(summary["seed"])
    for part, version in summary["versions"].items():
        assert f"{part} {version}" in page.facts["versions"]


def test_nothing_is_fetched(page):
    assert page.asks == []
    assert page.handlers == []


def is_rounded(figure, shown, least):
    """Return whether a number shown is the figure, to the least digits or to more where a miss asks for them."""
    digits = {len(text.partition(".")[2]) for text in shown}
    return any(f"{figure:.{each}f}" in shown for each in digits if each >= least)


def test_the_first_page_is_the_judgement_of_the_summary(page, summary):
    asked = summary["requirements"]
    table = page.front.table(f"Required of {asked['law']}")
    names = dict.fromkeys(each["requirement"] for each in asked["judged"])
    assert len(table.rows) == len(names)
    for row, name in zip(table.rows, names, strict=True):
        judged = [each for each in asked["judged"] if each["requirement"] == name]
        digits = 1 if name.endswith("_db") else 2
        shown = re.findall(r"-?\d+\.\d+", " ".join(row[2:-1]))
        assert all(is_rounded(each["figure"], shown, digits) for each in judged), (name, shown)
        assert ("missed" in row[-1]) == any(not each["met"] for each in judged)
    assert page.front.figures == ["felt"]


def test_figures_have_captions_and_names_of_their_own(page):
    names = [name for section in page.sections for name in section.figures]
    assert len(set(names)) == len(names)
    for section in page.sections:
        assert len(section.captions) == len(section.figures)
        assert all(section.captions)


def test_models_are_ranked_as_in_the_summary(page, summary):
    table = page.section("Identification").table("All channels")
    facts = summary["identification"]["table"]
    assert len(table.rows) == len(facts)
    for row, fact in zip(table.rows, facts, strict=True):
        assert row[:2] == [fact["structure"], str(fact["order"])]
        assert tenth(row[2], fact["median_fit_percent"])
        assert tenth(row[3], fact["worst_fit_percent"])
        assert same(row[4], fact["median_loss"], 3)
        assert row[5] == str(fact["ok"])


def test_the_papers_structure_is_judged_as_in_the_summary(page, summary):
    table = rows(page.section("Identification").table("The paper's structure"))
    facts = summary["identification"]["paper"]
    assert set(table) == set(facts)
    for name, fact in facts.items():
        assert tenth(table[name]["median fit %"], fact["median_fit_percent"])
        assert table[name]["all stable"] == ("yes" if fact["stable"] else "no")


def test_designs_are_those_of_the_summary(page, summary):
    section = page.section("Design")
    table = rows(section.table("Controllers"))
    assert set(table) == set(summary["design"])
    for name, fact in summary["design"].items():
        row = table[name]
        assert (row["method"], row["states"]) == (fact["method"], str(fact["states"]))
        for key in ("gamma", "achieved"):
            assert same(row[key], fact[key], 4), (name, key)
        assert tenth(row["peak of S, dB"], fact["peak_sensitivity_db"]), name
        limit = summary["limits"]["designs"][name]
        (beyond,) = (cell for head, cell in row.items() if head.startswith("no linear law beyond"))
        assert tenth(beyond, limit.get("limit_db")), "the limit stands beside its law"
        assert any(p.startswith(f"{name}: {fact['status']}") for p in section.paragraphs)


def test_loops_are_those_of_the_summary(page, summary):
    table = page.section("Closed loop").table("On the bench")
    by_law = {(row[0], row[1]): row[2:] for row in table.rows}
    for name, units in summary["closed_loop"].items():
        for unit, fact in units.items():
            cells = by_law[name, unit]
            assert fact["stable"], "the embedded study's laws settle on the bench"
            values = [tone[key] for tone in fact["tones"].values() for key in ("reduction_db", "paper_db")]
            values += [fact[k] for k in ("broadband_db", "worst_direction_band_db", "peak_amplification_db")]
            assert len(cells) == len(values)
            assert all(tenth(cell, value) for cell, value in zip(cells, values, strict=True)), (name, cells, values)
    idle = {row[0] for row in table.rows} - set(summary["closed_loop"])
    assert idle == {"no control"}


def test_limits_are_those_of_the_summary(page, summary):
    (table,) = page.section("Limits").tables
    table = rows(table)
    for name, fact in summary["limits"]["designs"].items():
        for head, key in (
            ("worst direction, dB", "attenuation_db"),
            ("none beyond, dB", "limit_db"),
            ("left, dB", "left_db"),
        ):
            cell, value = table[name][head], fact.get(key)
            assert tenth(cell, value) or (abs(value) >= 100 and abs(float(cell) - value) <= 0.5), (name, head)


def test_code_is_that_of_the_summary(page, summary):
    section = page.section("Code")
    table = rows(section.table("Generated C99"))
    assert set(table) == set(summary["deployment"])
    for name, fact in summary["deployment"].items():
        for key in ("states", "form", "c31_cycles", "c31_budget", "flash_bytes", "ram_bytes", "bit_exact"):
            assert table[name][figure_words(key)] == figure_text(fact.get(key)), (name, key)
        assert any(p.startswith(f"{name}: ") for p in section.paragraphs)


def test_no_name_of_the_program_stands_before_a_reader(page, demo):
    """Names with underscores and words of Python belong to files; a reader is told in words."""
    text = (demo[0] / "report.html").read_text(encoding="utf-8")
    shown = re.sub(r"<[^>]+>", " ", re.sub(r"<(script|style)\b.*?</\1>", " ", text, flags=re.DOTALL))
    found = set(re.findall(r"\b\w+_\w+\b|\b(?:True|False|None|null|nan)\b", shown)) | set(raw_words(unescape(shown)))
    print(f"{len(shown.split())} words, {len(found)} of them raw names")
    assert found == set()
