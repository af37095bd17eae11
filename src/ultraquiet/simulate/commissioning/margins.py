"""Margins of a loop from its measured sensitivity: what is there, and what a larger gain would leave."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.mu import mu_upper_bound
from ultraquiet.linalg.response import principal_gains
from ultraquiet.simulate.commissioning.injection import MeasuredLoop

CLOSER = 8  # lines
BETWEEN = 12  # gains looked at on the way to the next


def disk_margin_of(S: ComplexArray, f_hz: FloatArray) -> tuple[float, float]:
    """Return the disk margin of all channels of one end at once, and where it is least in Hz.

    alpha = 1 / max over f of mu(S - I / 2), mu over one complex factor a channel: each of them may be
    (1 + d / 2) / (1 - d / 2), |d| < alpha, as in `analyse.disk_margin`.

    Args:
        S: `(n, n, nf)`.
        f_hz: `(nf,)`.
    """
    M = S - 0.5 * np.eye(len(S))[:, :, None]
    # mu is below the largest singular value: lines that cannot be the worst by that need no closer look.
    bound = principal_gains(M)[0]
    order = np.argsort(-bound)
    best, at = 0.0, 0
    for start in range(0, order.size, CLOSER):
        lines = order[start : start + CLOSER]
        if bound[lines[0]] <= best:
            break
        size = mu_upper_bound(M[:, :, lines])
        k = int(np.argmax(size))
        if size[k] > best:
            best, at = float(size[k]), int(lines[k])
    return 1 / best, float(f_hz[at])


def peak_db(S: ComplexArray) -> FloatArray:
    """Return the largest singular value of S in dB, `(nf,)`."""
    return 20 * np.log10(principal_gains(S)[0])


def foreseen(loop: MeasuredLoop, gain: float, further: float) -> tuple[float, float, float]:
    """Return the least margin at either end on the way from a gain to a larger one, at which gain, and at which Hz.

    Of a loop L = I - S^-1 measured at `gain`, L further / gain is the loop at `further`: no model is asked. A gain
    on the way at which the loop would be on the verge of instability has no margin.
    """
    least = (np.inf, gain, 0.0)
    for S in loop.ends().values():
        each = np.moveaxis(S, 2, 0)
        one = np.eye(len(S))
        L = one - np.linalg.inv(each)
        for factor in np.linspace(1.0, further / gain, BETWEEN + 1)[1:]:
            margin, f = disk_margin_of(np.moveaxis(np.linalg.inv(one - factor * L), 0, 2), loop.f_hz)
            least = min(least, (margin, float(factor * gain), f))
    return least
