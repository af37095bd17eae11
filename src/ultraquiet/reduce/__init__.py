"""Fewer states for the same loop."""

from ultraquiet.reduce._abstract import ReductionResult
from ultraquiet.reduce.balanced import Balanced
from ultraquiet.reduce.closed_loop import ClosedLoopWeighted
from ultraquiet.reduce.hankel import HankelNorm

__all__ = ["Balanced", "ClosedLoopWeighted", "HankelNorm", "ReductionResult"]
