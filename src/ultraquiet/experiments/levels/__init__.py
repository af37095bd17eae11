"""Levels that a list leaves open, held against the ranges of the sensors before anything is recorded."""

from ultraquiet.experiments.levels.probe import SHORTER, Levelled, asks, levelled, lowered

__all__ = ["SHORTER", "Levelled", "asks", "levelled", "lowered"]
