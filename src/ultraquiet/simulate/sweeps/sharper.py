"""Directions from the loud runs themselves, where the short ones before them were too coarse to hear weak ones."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sweeps.directions import Directions, between


def sharper(f_hz: FloatArray, G: ComplexArray, known: np.ndarray) -> Directions:
    """Return the directions at every line of a run.

    Short runs know weak directions but roughly, and a grid is wider than resonances are: what moves others too, a
    hundred times stronger ones, takes the range that weak ones need.

    Args:
        f_hz: the lines.
        G: what the run showed, `(ny, nu, lines)`, every channel in its range.
        known: the lines, one at least, at which noise leaves the weakest direction; others lie between them.
    """
    at = np.flatnonzero(known)
    return Directions.of(f_hz, np.array([[between(f_hz, f_hz[at], g[at]) for g in row] for row in G]))
