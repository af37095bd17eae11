"""Room `limits`: what no linear controller can exceed on a given plant.

May be changed here: the limits that are computed and how. Nothing here designs a controller for use.
"""

from ultraquiet.limits._limit import Limit
from ultraquiet.limits.convex import best_flat_attenuation

__all__ = ["Limit", "best_flat_attenuation"]
