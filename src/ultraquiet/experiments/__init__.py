"""Experiments: a list of commands in TOML, checked whole, executed in order, one record per measurement."""

from ultraquiet.experiments.catalogue import Entry, find
from ultraquiet.experiments.listed import ExperimentList, load, parse
from ultraquiet.experiments.mistakes import ListError
from ultraquiet.experiments.run import run

__all__ = ["Entry", "ExperimentList", "ListError", "find", "load", "parse", "run"]
