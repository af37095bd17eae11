"""Experiments: a list of commands in TOML, checked whole, executed in order, one record per measurement."""

from ultraquiet._base.shown import show
from ultraquiet.experiments.catalogue import find, rebuild, search
from ultraquiet.experiments.clock import real_time
from ultraquiet.experiments.dry import DryRun, DryStep, dry_run
from ultraquiet.experiments.entry import Entry
from ultraquiet.experiments.listed import ExperimentList, load, parse
from ultraquiet.experiments.live import Course, Levels, Onlooker
from ultraquiet.experiments.mistakes import ListError
from ultraquiet.experiments.run import run
from ultraquiet.experiments.states import State, StoppedError, states

__all__ = [
    "Course",
    "DryRun",
    "DryStep",
    "Entry",
    "ExperimentList",
    "Levels",
    "ListError",
    "Onlooker",
    "State",
    "StoppedError",
    "dry_run",
    "find",
    "load",
    "parse",
    "real_time",
    "rebuild",
    "run",
    "search",
    "states",
]

show(globals(), __all__)
