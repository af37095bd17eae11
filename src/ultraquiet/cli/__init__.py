"""Room `cli`: the command line, one file a command.

May be changed here: words, options and how results are printed. No computation: every command calls a room below.
"""

from ultraquiet.cli.app import main

__all__ = ["main"]
