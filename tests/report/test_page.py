"""The page of a report: everything given stands on it, as given, and nothing is fetched or run."""

import json
import re

import numpy as np
import pytest

from read_page import Page
from ultraquiet.plot import Figure, Line, Panel
from ultraquiet.report import Front, Report, Section, Span, Table, Verdict, render, write

pytestmark = pytest.mark.web


def figure(name):
    line = Line.of(np.arange(10.0), np.arange(10.0) ** 2, "curve")
    return Figure(name, f"title of {name}", f"caption of {name}.", [Panel([line], "", "time (s)", "V")])


@pytest.fixture
def report():
    sections = [
        Section("First", ["one & two", "a < b"], [Table("numbers", ("name", "dB"), [("x", 1.5), ("<y>", "-")])]),
        Section("Second", [], [], [figure("one"), figure("two")]),
        Section("Third", ["only words"], [Table("empty", ("a", "b", "c"), [])], [figure("three")]),
    ]
    return Report("A <title>", "The lead.", [("seed", "7"), ("bench", "hexapod")], sections)


def test_every_part_stands_on_the_page_in_order(report):
    page = Page(render(report))
    assert page.title == report.title
    assert page.lead == report.lead
    assert list(page.facts.items()) == list(report.facts)
    assert [s.title for s in page.sections] == [s.title for s in report.sections]
    for read, given in zip(page.sections, report.sections, strict=True):
        assert read.paragraphs == list(given.paragraphs)
        assert [t.caption for t in read.tables] == [t.caption for t in given.tables]
        for table, source in zip(read.tables, given.tables, strict=True):
            assert table.heads == list(source.columns)
            assert table.rows == [[str(cell) for cell in row] for row in source.rows]
        assert read.figures == [f.name for f in given.figures]
        assert read.captions == [f.caption for f in given.figures]


def test_the_way_through_the_page_leads_to_its_sections(report):
    page = Page(render(report))
    assert page.links == [(f"#{s.anchor}", s.title) for s in page.sections]


def specs(text):
    return json.loads(re.search(r'id="uq-specs">(.*?)</script>', text, re.DOTALL)[1])


def test_each_figure_is_drawn_once_within_its_section(report):
    text = render(report)
    assert set(specs(text)) == {"one", "two", "three"}
    for name in ("one", "two", "three"):
        found = re.search(rf'<figure id="{name}">(.*?)</figure>', text, re.DOTALL)[1]
        assert found.count("data:image/png;base64,") == 1
        assert found.count(f'data-chart="{name}"') == 1
        assert f"title of {name}" in found


def test_figures_of_one_name_do_not_take_each_others_place():
    curves = [Line.of(np.arange(10.0), k * np.arange(10.0), f"curve {k}") for k in range(3)]
    same = [Figure("same", f"title {k}", f"caption {k}.", [Panel([c], "", "s", "V")]) for k, c in enumerate(curves)]
    text = render(Report("A", "The lead.", [], [Section("One", [], [], same[:2]), Section("Two", [], [], same[2:])]))
    assert re.findall(r'<figure id="([^"]+)">', text) == ["same", "same-2", "same-3"]
    for k, found in enumerate(re.findall(r"<figure id=.*?</figure>", text, re.DOTALL)):
        assert f"title {k}" in found
    drawn = [spec["panels"][0]["curves"][0]["name"] for spec in specs(text).values()]
    assert drawn == ["curve 0", "curve 1", "curve 2"]


OWN_SCRIPTS = 5  # a word for the style sheet, numbers, specs, the charts, what the page does


def test_the_page_fetches_nothing_and_runs_its_own_scripts_alone(report):
    text = render(report)
    page = Page(text)
    assert page.asks == []
    assert page.scripts == OWN_SCRIPTS
    assert page.handlers == []
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)


def test_the_first_page_says_what_was_asked_and_reached():
    rows = [["a", "3 dB", "2.9", Verdict.of(False)], ["b", "1", Span("1.2", 1), Verdict.of(True)]]
    table = Table("Required", ("requirement", "asked", "reached", "verdict"), rows)
    front = Front("Not quiet", Verdict("not ok", "bad", "1 of 2"), "below", [table], [figure("hero")], ["run <this>"])
    text = render(Report("A", "The lead.", [("seed", "7")], [Section("One", ["words"])], front))
    page = Page(text)
    assert page.front.figures == ["hero"]
    assert page.front.table("Required").rows == [["a", "3 dB", "2.9", "■ missed"], ["b", "1", "1.2", "● met"]]
    assert "■ not ok" in re.sub(r"<[^>]+>|\s+", " ", text).replace("  ", " ").replace("  ", " ")
    assert "run &lt;this&gt;" in text


def test_what_a_record_is_called_cannot_become_a_tag():
    hostile = '<script>alert(1)</script>"><img src=x>'
    text = render(
        Report(
            hostile,
            hostile,
            [(hostile, hostile)],
            [Section(hostile, [hostile], [Table(hostile, (hostile,), [(hostile,)])])],
        )
    )
    page = Page(text)
    assert page.scripts == 2  # without figures, the word for the style sheet and what the page does
    assert page.handlers == []
    assert page.asks == []
    assert page.title == page.lead == page.sections[0].title == page.sections[0].paragraphs[0] == hostile
    assert page.sections[0].tables[0].rows == [[hostile]]


def test_words_stand_at_the_left_numbers_at_the_right_and_a_long_caption_wraps():
    rows = [("one", "input", "-1.5 at 5 Hz", "yes", 3), ("two", "output", "-", "no", 4)]
    heads = ("law", "end", "least", "kept", "band, 10-100 Hz")
    short, long_ = Table("short", heads, rows), Table("a long caption " * 8, heads, rows)
    text = render(Report("A", "The lead.", [], [Section("One", [], [short, long_])]))
    cells = re.findall(r"<tr><td.*?</tr>", text)[0]
    kinds = [kind or "" for kind in re.findall(r"<td(?: class=\"(\w+)\")?>", cells)]
    assert kinds == ["word", "word", "", "word", ""]
    assert text.count('<caption class="long">') == 1
    assert '<span class="held">10-100 Hz</span>' in text
    front = Front("Quieter by 20.1 dB in every direction, 10-100 Hz", figures=[figure("hero")])
    head = render(Report("t", "l", [], [], front))
    assert '<span class="held">20.1 dB</span> in every direction, <span class="held">10-100 Hz</span>' in head
    assert Page(text).sections[0].tables[0].heads == list(heads)


def test_the_file_is_the_page(report, tmp_path):
    path = write(report, tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == render(report)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_hostile_name_in_a_figure_stays_data():
    hostile = "</script><script>alert(1)</script>"
    line = Line.of(np.arange(3.0), np.arange(3.0), hostile)
    picture = Figure("one", hostile, hostile, [Panel([line], hostile, hostile, hostile)])
    page = Page(render(Report("A", "The lead.", [], [Section("One", [], [], [picture])])))
    assert page.scripts == OWN_SCRIPTS
