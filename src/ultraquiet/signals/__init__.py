"""Test signals: each a frozen settings object whose verb `generate` is deterministic in its seed."""

from ultraquiet._base.shown import show
from ultraquiet.signals._abstract import MAXIMUM_V, Signal
from ultraquiet.signals.chirp import Chirp
from ultraquiet.signals.multisine import Multisine
from ultraquiet.signals.noise import BandLimitedNoise
from ultraquiet.signals.orthogonal import orthogonal_multisines
from ultraquiet.signals.prbs import Prbs
from ultraquiet.signals.schedule import on_actuator
from ultraquiet.signals.step import Step
from ultraquiet.signals.tone import Tone

__all__ = [
    "MAXIMUM_V",
    "BandLimitedNoise",
    "Chirp",
    "Multisine",
    "Prbs",
    "Signal",
    "Step",
    "Tone",
    "on_actuator",
    "orthogonal_multisines",
]

show(globals(), __all__)
