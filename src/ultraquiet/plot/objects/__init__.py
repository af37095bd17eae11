"""Every object's figure: importing this enters them all."""

from ultraquiet.plot.objects import anything, benches, code, evidence, loops, models, signals

__all__ = ["anything", "benches", "code", "evidence", "loops", "models", "signals"]
