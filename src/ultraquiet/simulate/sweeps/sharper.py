"""Directions from the loud runs themselves, where the short ones before them were too coarse to hear weak ones."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sweeps.clock import SweepClock
from ultraquiet.simulate.sweeps.directions import Directions, directions

# A response is known where noise leaves less than this of its weakest direction open; directions of other lines are
# between those of known ones.
KNOWN = 0.3


def sharper(sweep: SweepClock, G: ComplexArray, deviation: FloatArray) -> Directions | None:
    """Return the directions at every line of a run, or None where no line is known.

    Short runs know weak directions but roughly, and a grid is wider than resonances are: what moves others too, a
    hundred times stronger ones, takes the range that weak ones need.

    Args:
        sweep: of the run.
        G: what it showed, `(ny, nu, lines)`, every channel in its range.
        deviation: what noise leaves open of the weakest direction at each line, `(lines,)`, over its size.
    """
    f = sweep.lines_hz
    known = np.flatnonzero(deviation < KNOWN)
    if not known.size:
        return None
    own = slice(None, None, sweep.finer)  # lines of the run itself
    rows = [[_between(f[own], f[known], g[known]) for g in row] for row in G]
    return Directions(f[own], np.moveaxis(directions(np.moveaxis(np.array(rows), 2, 0)), 0, 2))


def _between(f_hz: FloatArray, known_hz: FloatArray, values: ComplexArray) -> ComplexArray:
    return np.interp(f_hz, known_hz, values.real) + 1j * np.interp(f_hz, known_hz, values.imag)
