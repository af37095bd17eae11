"""Room `report`: one self-contained HTML file.

May be changed here: what a report is made of (`content.py`), how its figures come on the page (`figures.py`) and how
the page looks and behaves (`html.py`, `page.html.j2`, `page.css`, `page.js`). The report computes nothing; the pipeline
fills it.
"""

from ultraquiet._base.shown import show
from ultraquiet.report.content import Front, Picture, Report, Section, Span, Table, Verdict
from ultraquiet.report.html import render, write

__all__ = ["Front", "Picture", "Report", "Section", "Span", "Table", "Verdict", "render", "write"]

show(globals(), __all__)
