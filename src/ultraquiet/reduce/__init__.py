"""Fewer states for the same loop."""

from ultraquiet._base.shown import show
from ultraquiet.reduce._abstract import ReductionResult
from ultraquiet.reduce.balanced import Balanced
from ultraquiet.reduce.certificate import held
from ultraquiet.reduce.closed_loop import ClosedLoopWeighted
from ultraquiet.reduce.coprime import CoprimeFactors, reduce_observer_based
from ultraquiet.reduce.hankel import HankelNorm
from ultraquiet.reduce.promises import Delivered, Promise
from ultraquiet.reduce.weighted import FrequencyWeighted

__all__ = [
    "Balanced",
    "ClosedLoopWeighted",
    "CoprimeFactors",
    "Delivered",
    "FrequencyWeighted",
    "HankelNorm",
    "Promise",
    "ReductionResult",
    "held",
    "reduce_observer_based",
]

show(globals(), __all__)
