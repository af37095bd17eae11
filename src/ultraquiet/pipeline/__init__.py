"""Room `pipeline`: the only place that knows the order of the walk.

May be changed here: the study file's vocabulary (`study.py`), the order of the stages (`stages.py`), what each does
with the rooms below (`identification.py`, `validation.py`, `control.py`, `limits.py`), what it finds out (`facts/`),
what is reported of it (`summary.py`, `report/`).
"""

from ultraquiet.pipeline.study import Study, load_study, packaged_study, quick_study, reload_study
from ultraquiet.pipeline.walk import conduct, one_case, walk

__all__ = [
    "Study",
    "conduct",
    "load_study",
    "one_case",
    "packaged_study",
    "quick_study",
    "reload_study",
    "walk",
]
