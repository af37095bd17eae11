"""Everything a study knows when it is through."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.study import Study
from ultraquiet.values import Record


@dataclass(frozen=True)
class StudyResult:
    """Everything a study knows when it is through; what report and summary are written from."""

    study: Study
    bench: Any
    records: Mapping[str, Record]
    identified: Outcome
    plant: Outcome
    validated: Outcome
    analysed: Outcome
    designs: Mapping[str, Outcome]
    loops: Mapping[str, Outcome]
    deployment: Mapping[str, Mapping[str, Any]]
    bounds: Outcome
