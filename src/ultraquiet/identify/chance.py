"""Whether inputs explain more of an output than chance would, and the verdict where they do not."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.linalg import prediction
from ultraquiet.linalg.lagged import Lagged, products_of_shifts
from ultraquiet.values import Status, StatusWord

TINY = float(np.finfo(float).tiny)


def explained(y: FloatArray, error: FloatArray) -> float:
    """Return the share of an output's own innovations, `(n,)`, that a simulation explains which leaves `error` of it.

    Noise of a colour, and what a model does at its resonance, carry most of their power at few frequencies: there
    chance explains much. Compared are the variances that autoregressions of output and error leave, whose logarithms
    are means over frequency alike: log(1 - share) is twice the information on the output that a sample of inputs holds.

    >>> rng = np.random.default_rng(0)
    >>> y, e = rng.standard_normal((2, 5000))
    >>> round(explained(y + e, e), 1), explained(e, e + 0.01 * y)
    (0.5, 0.0)
    """
    if not np.all(np.isfinite(error)):
        return 0.0
    return _share(*(_innovation_in_memory(x - x.mean()) for x in (y, error)))


def explained_together(sets: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Return the share that stands for several pairs of `explained`: the information that inputs hold adds up."""
    told = sum(y.size * np.log(max(1.0 - explained(y, error), TINY)) for y, error in sets)
    return float(1.0 - np.exp(told / sum(y.size for y, _ in sets)))


def explained_of(sums: Lagged, output: int, error: int) -> float:
    """Return the same from the products of an output and an error among other signals."""
    products, lags = sums.products(centred=True), min(prediction.MEMORY, sums.lags)
    head, tail = sums.head[:, :lags] - sums.mean[:, None], sums.tail[:, -lags:] - sums.mean[:, None]
    return _share(*(_innovation(products[: lags + 1, i, i], head[i], tail[i], sums.samples) for i in (output, error)))


def _share(before: float, after: float) -> float:
    return max(0.0, 1.0 - after / max(before, TINY))


def _innovation_in_memory(x: FloatArray) -> float:
    """Return `_innovation` of a centred signal; for so few lags sums are faster than transforms."""
    lags = min(prediction.MEMORY, x.size // 10)
    r = np.array([x[: x.size - k] @ x[k:] for k in range(lags + 1)])
    return _innovation(r, x[:lags], x[x.size - lags :], x.size)


def _innovation(r: FloatArray, head: FloatArray, tail: FloatArray, samples: int) -> float:
    """Return the mean square that an autoregression leaves of a signal, by least squares over known pasts alone.

    `r` are the centred products of the signal with its own past, `(lags + 1,)`, `head` and `tail` its `lags` first and
    last samples. With zeros for what lies beyond the ends, a signal that rings as long as its record would seem to be
    less known.
    """
    G = products_of_shifts(r, tail, head)
    G[np.diag_indices_from(G)] += prediction.RIDGE * np.trace(G) / len(G)
    known = np.linalg.lstsq(G[1:, 1:], G[1:, 0], rcond=None)[0]
    return float(G[0, 0] - known @ G[1:, 0]) / max(samples - head.size, 1)


def by_chance(share: float, samples: int, parameters: float) -> bool:
    """Return whether the inputs explain no more of the output than chance would.

    Of an output that has nothing to do with the inputs p free numbers take the share R^2 of the power in n samples, and
    n R^2 is chi-square of p degrees of freedom; poles are sought among n / 2 lines, so the largest of as many is what
    chance gives (Bonferroni). A residual that is white and free of the inputs is then no praise.
    """
    from scipy.special import chdtrc

    return bool(0.5 * samples * chdtrc(parameters, samples * share) >= SIGNIFICANCE)


def numbers_of(states: int, inputs: int) -> int:
    """Return of how many numbers one output of a state-space model is made, its past and a constant too."""
    return states * (inputs + 3) + inputs + 1


def unless_silent(status: Status, share: float, samples: int, parameters: float, free: float | None = None) -> Status:
    """Return the verdict on one output, no longer `ok` where its inputs explain no more of it than chance would.

    A model of nothing may end anywhere, and what it leaves may have any colour. Where the p-value `free` says that its
    error holds nothing of the inputs either, they have nothing to do with the output, and that is said first.
    """
    asked = status.ok or (free is not None and of_nothing(status, free))
    return silence(share) if asked and by_chance(share, samples, parameters) else status


def of_nothing(status: Status, free: float) -> bool:
    """Return whether a verdict that is not `ok` may be on a model of nothing: its error is free of the inputs."""
    return status.word in (StatusWord.NOT_WHITE, StatusWord.NOT_CONVERGED) and free >= SIGNIFICANCE


def silence(share: float) -> Status:
    """Return the verdict on a model that explains no more of an output than chance would."""
    return Status(
        StatusWord.POOR_FIT,
        f"The inputs explain {share:.1%} of what is new in the output, no more than such a model does by chance: see "
        f"that inputs and outputs are not swapped and belong to one run, or excite more strongly.",
    )
