"""Nodes and weights that resolve every root of a loop."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

POINTS = 8  # of Gauss and Legendre's rule in each panel
NARROWEST = 1e-9  # of the whole range: a root on the axis leaves an error of that order
HALVINGS = 60


def nodes(roots: ComplexArray, rate_hz: float | None, far: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies in Hz and their weights for integrals from 0 to Nyquist, or to infinity in continuous time.

    Panels are halved until none is wider than its middle's distance from the nearest root: a smooth function on each.

    Args:
        roots: poles and zeros of the loop in the half-plane, rad/s.
        rate_hz: sampling rate, None for continuous time.
        far: how many times the largest root the range ends, in continuous time.
    """
    s = roots[np.isfinite(roots)]
    if rate_hz is not None:
        # the angle of z is arctan of the half-plane's frequency: roots go there with their distance from the axis
        s = 1j * rate_hz * 2 * np.arctan(s / (2j * rate_hz) * (1 - 1e-12))
    s = s[np.isfinite(s)] / (2 * np.pi)
    top = rate_hz / 2 if rate_hz is not None else far * max(float(np.abs(s).max(initial=0.0)), 1e-3)
    low, high = np.zeros(1), np.full(1, top)
    done: list[tuple[FloatArray, FloatArray]] = []
    for _ in range(HALVINGS):
        middle, width = (low + high) / 2, high - low
        near = np.abs(1j * middle[:, None] - s[None, :]).min(axis=1, initial=np.inf)
        wide = (width > near) & (width > NARROWEST * top)
        done.append((low[~wide], high[~wide]))
        low, high = np.concatenate([low[wide], middle[wide]]), np.concatenate([middle[wide], high[wide]])
        if not low.size:
            break
    low, high = (np.concatenate(ends) for ends in zip(*[*done, (low, high)], strict=True))
    x, weight = np.polynomial.legendre.leggauss(POINTS)
    f = ((low + high) / 2)[:, None] + ((high - low) / 2)[:, None] * x
    order = np.argsort(f.ravel())
    return f.ravel()[order], ((high - low)[:, None] / 2 * weight).ravel()[order]
