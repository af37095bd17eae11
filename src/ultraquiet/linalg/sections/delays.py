"""Minima of the sum of squares that differ by their delay.

A numerator's far real zero turns the phase as a delay does: exp(-s tau) (1 - s/z) and exp(-s (tau + 2/z)) (1 + s/z)
agree to (f/z)^3. Each is a minimum of its own, and a search settles in the one that it starts nearer to.
"""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg.sections.search import FrequencySamples, SectionFit, SectionShape, evaluate, search

# Delays looked at on both sides of a minimum: from a quarter of the shortest period down, each by so much smaller. The
# basin of a minimum d away is about d wide; nearer than a two-hundredth of the quarter they agree beyond any noise.
NEARER, LOOKS = 1.25, 25
# So many of the best basins are searched.
BASINS = 4
# Minima nearer than this share of the first one's deviation are the same.
SAME = 0.1


def minima(
    samples: FrequencySamples, shape: SectionShape, here: SectionFit, steps: int, slowest: float
) -> list[SectionFit]:
    """Return the minimum given and those at other delays within a quarter of the shortest period, the lowest first.

    Args:
        samples: what is fitted.
        shape: one whose delay is free.
        here: a minimum of it.
        steps: of the search from each basin; one that does not end within them is left out.
        slowest: as `search` takes it.
    """
    quarter = np.pi / 2 / float(samples.f_rad.max())
    away = quarter * NEARER ** -np.arange(LOOKS, dtype=np.float64)
    offsets = np.concatenate([-away, [0.0], away[::-1]])
    costs = [evaluate(samples, shape, _moved(here, offset)).cost for offset in offsets[offsets != 0.0]]
    cost = np.insert(np.array(costs), LOOKS, here.cost)
    inner = np.arange(1, cost.size - 1)
    basins = inner[(cost[inner] < cost[inner - 1]) & (cost[inner] < cost[inner + 1]) & (inner != LOOKS)]
    found = [here]
    for k in basins[np.argsort(cost[basins])][:BASINS]:
        there, _, converged = search(samples, shape, _moved(here, float(offsets[k])), steps, slowest)
        if converged and all(_apart(there, other) for other in found):
            found.append(there)
    return sorted(found, key=lambda point: point.cost)


def _moved(here: SectionFit, offset_s: float) -> FloatArray:
    theta = here.theta.copy()
    theta[-1] += offset_s
    return theta


def _apart(one: SectionFit, other: SectionFit) -> bool:
    """Return whether two minima differ by their delay, measured by the deviation of one for given poles."""
    return bool(abs(one.theta[-1] - other.theta[-1]) * np.sqrt(other.normal[-1, -1]) > SAME)
