"""What can be said about a system or a loop without changing it: norms, zeros, margins, symmetry."""

from ultraquiet._base.shown import show
from ultraquiet.analyse.disk import (
    ChannelChange,
    DiskMargins,
    EndMargins,
    disk_margin,
    disk_margins,
    disk_ranges,
    end_margins,
)
from ultraquiet.analyse.gang import Gang, Peak, gang_of_four, gang_of_six, peak_gain
from ultraquiet.analyse.loop_response import band_attenuation
from ultraquiet.analyse.margins import Margins, loop_margins, peak_sensitivity
from ultraquiet.analyse.monte_carlo import MonteCarlo, monte_carlo, wilson_interval
from ultraquiet.analyse.mu import MuBounds, mu_bounds, mu_peak, mu_upper_bound
from ultraquiet.analyse.norms import h2_norm, hinf_norm, l2_norm
from ultraquiet.analyse.singular import singular_values
from ultraquiet.analyse.structure import PerturbationBlock
from ultraquiet.analyse.symmetry import reciprocity_error, threefold_error
from ultraquiet.analyse.zeros import Roots, poles, roots, zeros

Block = PerturbationBlock  # its first name

__all__ = [
    "Block",
    "ChannelChange",
    "DiskMargins",
    "EndMargins",
    "Gang",
    "Margins",
    "MonteCarlo",
    "MuBounds",
    "Peak",
    "PerturbationBlock",
    "Roots",
    "band_attenuation",
    "disk_margin",
    "disk_margins",
    "disk_ranges",
    "end_margins",
    "gang_of_four",
    "gang_of_six",
    "h2_norm",
    "hinf_norm",
    "l2_norm",
    "loop_margins",
    "monte_carlo",
    "mu_bounds",
    "mu_peak",
    "mu_upper_bound",
    "peak_gain",
    "peak_sensitivity",
    "poles",
    "reciprocity_error",
    "roots",
    "singular_values",
    "threefold_error",
    "wilson_interval",
    "zeros",
]

show(globals(), __all__)
