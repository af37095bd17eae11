"""Fewer states for the same loop."""

from ultraquiet.reduce._abstract import ReductionResult
from ultraquiet.reduce.balanced import Balanced
from ultraquiet.reduce.closed_loop import ClosedLoopWeighted

__all__ = ["Balanced", "ClosedLoopWeighted", "ReductionResult"]
