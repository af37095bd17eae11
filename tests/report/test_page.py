"""The page of a report: everything given stands on it, as given, and nothing is fetched or run."""

import re

import numpy as np
import pytest
from read_page import Page

from ultraquiet.plot import Figure, Line, Panel
from ultraquiet.report import Report, Section, Table, render, write

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


def test_each_figure_is_drawn_once_within_its_section(report):
    text = render(report)
    assert text.count("<svg") == 3
    for name in ("one", "two", "three"):
        found = re.search(rf'<figure id="{name}">(.*?)</figure>', text, re.DOTALL)[1]
        assert found.count("<svg") == 1
        assert f"title of {name}" in found


def test_figures_of_one_name_do_not_take_each_others_place():
    curves = [Line.of(np.arange(10.0), k * np.arange(10.0), f"curve {k}") for k in range(3)]
    same = [Figure("same", f"title {k}", f"caption {k}.", [Panel([c], "", "s", "V")]) for k, c in enumerate(curves)]
    text = render(Report("A", "The lead.", [], [Section("One", [], [], same[:2]), Section("Two", [], [], same[2:])]))
    assert re.findall(r'<figure id="([^"]+)">', text) == ["same", "same-2", "same-3"]
    for k, found in enumerate(re.findall(r"<figure id=.*?</figure>", text, re.DOTALL)):
        assert f"title {k}" in found
        assert f"curve {k}" in found


def test_the_page_fetches_and_runs_nothing(report):
    text = render(report)
    page = Page(text)
    assert page.asks == []
    assert page.scripts == 0
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)


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
    assert page.scripts == 0
    assert page.asks == []
    assert page.title == page.lead == page.sections[0].title == page.sections[0].paragraphs[0] == hostile
    assert page.sections[0].tables[0].rows == [[hostile]]


def test_the_file_is_the_page(report, tmp_path):
    path = write(report, tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == render(report)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
