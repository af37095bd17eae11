"""Room `workbench`: a study by hand, in the browser, on this machine alone.

May be changed here: what a hand can do and how it is kept (`engine/`, which knows no pages), how work is done beside
the pages (`jobs/`), and the pages themselves (`web/`, the only place that imports NiceGUI).
"""

from ultraquiet.workbench.engine.making.prepare import detrended
from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.engine.written.calls import further, law, plant, read_channels

__all__ = ["Session", "detrended", "further", "law", "plant", "read_channels"]
