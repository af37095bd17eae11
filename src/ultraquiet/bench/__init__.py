"""Benches: anything with a rate, channels and the verb `run`, simulated, replayed or wrapped."""

from ultraquiet._base.shown import show
from ultraquiet.bench._abstract import Bench, Block, Streaming, Tally
from ultraquiet.bench.blended import Blended
from ultraquiet.bench.decimated import Decimated, HeldController
from ultraquiet.bench.fmu import Fmu
from ultraquiet.bench.hardware.bench import Hardware
from ultraquiet.bench.hardware.interlocks import Interlocks
from ultraquiet.bench.hexapod import Hexapod
from ultraquiet.bench.linear import LinearBench
from ultraquiet.bench.process.bench import Process
from ultraquiet.bench.replay import Replay
from ultraquiet.bench.wrapped import Wrapped

__all__ = [
    "Bench",
    "Blended",
    "Block",
    "Decimated",
    "Fmu",
    "Hardware",
    "HeldController",
    "Hexapod",
    "Interlocks",
    "LinearBench",
    "Process",
    "Replay",
    "Streaming",
    "Tally",
    "Wrapped",
]

show(globals(), __all__)
