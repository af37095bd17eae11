"""Margins of a loop from its measured sensitivity: what is there, and what a larger gain would leave."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.mu import mu_upper_bound
from ultraquiet.linalg.response import principal_gains
from ultraquiet.simulate.commissioning.injection import MeasuredLoop

CLOSER = 8  # lines
VERGE = 1e-2  # a disk margin below it is none: beyond lies another loop, stable or not


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

    Of a loop L = I - S^-1 measured at `gain`, L further / gain is the loop at `further`: no model is asked. A disk
    margin alpha allows every gain to rise by (1 + alpha / 2) / (1 - alpha / 2), so that no step of half of that, in
    logarithms, passes the verge of instability; where the steps end at one, nothing is left.
    """
    least = (np.inf, gain, 0.0)
    for S in loop.ends().values():
        one = np.eye(len(S))
        L = one - np.linalg.inv(np.moveaxis(S, 2, 0))
        margin, factor, end = disk_margin_of(S, loop.f_hz)[0], 1.0, further / gain
        while factor < end and margin > VERGE:
            allowed = (1 + margin / 2) / (1 - margin / 2) if margin < 2 else np.inf
            factor = min(end, factor * np.sqrt(allowed))
            there = np.asarray(np.linalg.inv(one - factor * L), dtype=np.complex128)
            margin, f = disk_margin_of(np.moveaxis(there, 0, 2), loop.f_hz)
            least = min(least, (margin, float(factor * gain), f))
    return least
