"""SUITE's hexapod: six struts, each a piezo stack, a geophone and a viscoelastic stage, between base and payload."""

from ultraquiet.bench.hexapod.unit import Hexapod

__all__ = ["Hexapod"]
