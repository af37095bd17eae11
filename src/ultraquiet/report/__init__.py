"""Room `report`: one self-contained HTML file.

May be changed here: what a report is made of (`content.py`) and how the page looks (`html.py`, `page.html.j2`). The
report computes nothing; the pipeline fills it.
"""

from ultraquiet._base.shown import show
from ultraquiet.report.content import Report, Section, Table
from ultraquiet.report.html import render, write

__all__ = ["Report", "Section", "Table", "render", "write"]

show(globals(), __all__)
