"""Room `testing`: checks that authors of plug-ins can call on their own methods.

May be changed here: what every registered method must do, whatever it is.
"""

from ultraquiet.testing.conformance import check

__all__ = ["check"]
