"""What can be said about a system or a loop without changing it: norms, zeros, margins, symmetry."""

from ultraquiet.analyse.margins import Margins, loop_margins, peak_sensitivity
from ultraquiet.analyse.norms import h2_norm, hinf_norm

__all__ = ["Margins", "h2_norm", "hinf_norm", "loop_margins", "peak_sensitivity"]
