"""Room `limits`: what no linear controller can exceed on a given plant.

May be changed here: the limits that are computed and how. Nothing here designs a controller for use.
"""

from ultraquiet._base.shown import show
from ultraquiet.limits._limit import Limit
from ultraquiet.limits.by_direction import DirectionLimit, by_direction
from ultraquiet.limits.convex import best_flat_attenuation
from ultraquiet.limits.directions import principal_directions
from ultraquiet.limits.distance import Distance, distance
from ultraquiet.limits.integrals import Integral, bode_integral, poisson_integral
from ultraquiet.limits.waterbed import waterbed_peak

__all__ = [
    "DirectionLimit",
    "Distance",
    "Integral",
    "Limit",
    "best_flat_attenuation",
    "bode_integral",
    "by_direction",
    "distance",
    "poisson_integral",
    "principal_directions",
    "waterbed_peak",
]

show(globals(), __all__)
