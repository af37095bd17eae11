"""Controllers from plants: settings objects with one verb, `design`, and the synthesis for a generalised plant."""

from ultraquiet.design._abstract import DesignMethod, DesignResult
from ultraquiet.design.hinf import synthesize_hinf
from ultraquiet.design.lqg import Lqg
from ultraquiet.design.weights import band_pass, high_pass, peak

__all__ = ["DesignMethod", "DesignResult", "Lqg", "band_pass", "high_pass", "peak", "synthesize_hinf"]
