"""How objects show themselves: one line, a card for notebooks, a picture."""

from ultraquiet._base.shown.drawing import draws, figure_of
from ultraquiet._base.shown.line import counted, loudness
from ultraquiet._base.shown.shown import Shown, show

__all__ = ["Shown", "counted", "draws", "figure_of", "loudness", "show"]
