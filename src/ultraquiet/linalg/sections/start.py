"""Where the search for sections begins: vector fitting from several spreads, or a smaller fit and one pair more."""

from collections.abc import Iterator

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.sections import search as sections
from ultraquiet.linalg.vector_fitting import paired, relocated_in_s

RELOCATIONS = 8
# Every so-manieth line is enough to start from.
MOST_LINES = 600
# Gains below this share of their channel's largest are weighed as if they were that large.
FAINT = 1e-3
# Starting poles: relative damping of the pairs.
DAMPING = 0.02
# The place where a fit misses most is sought in a mean over so many lines.
SMOOTHED = 5
# The last so many relocations are tried: near the noise they wander rather than converge.
TRIED = 2


def spreads(s: ComplexArray, order: int) -> Iterator[ComplexArray]:
    """Return starting poles on the scaled imaginary axis, evenly in frequency and in its logarithm."""
    low, high = float(np.abs(s).min()), float(np.abs(s).max())
    low = max(low, 1e-4 * high)
    for centres in (np.geomspace(low, high, order // 2 + 2)[1:-1], np.linspace(low, high, order // 2 + 2)[1:-1]):
        upper = centres * (-DAMPING + 1j)
        real = np.full(order % 2, -np.sqrt(low * high))
        yield paired(np.concatenate([upper, upper.conj(), real]).astype(np.complex128))


def starts(
    samples: sections.FrequencySamples, H: ComplexArray, weight: FloatArray, shape: sections.SectionShape
) -> Iterator[FloatArray]:
    """Yield starting points for a fit to the responses H with weights, `(ny, nu, nf)` each.

    One spread of poles is relocated by the given weights, the other by weights relative to the response, on the
    imaginary axis of the bilinear image, where both times look alike.
    """
    s, scale = _axis(samples)
    some = slice(None, None, 1 + s.size // max(MOST_LINES, 2 * shape.order))
    s, H, weight = s[some], H[:, :, some], weight[:, :, some]
    size = np.abs(H)
    largest = size.max(axis=2, keepdims=True)
    raised = np.maximum(size, FAINT * np.where(largest > 0, largest, 1.0))
    relative = np.where(weight > 0, 1.0 / raised, 0.0)
    constant = shape.direct or samples.rate_hz is not None
    for w, poles in zip((weight, relative), spreads(s, shape.order), strict=True):
        p = poles
        for k in range(RELOCATIONS):
            p = relocated_in_s(s, H, w, p, constant)
            if k >= RELOCATIONS - TRIED:
                yield sections.from_axis_poles(p * scale)


def enlarged(samples: sections.FrequencySamples, before: sections.SectionFit, order: int, wanted: int) -> FloatArray:
    """Return the sections of a fit one or two orders smaller, and another pair where it misses most, or a real pole."""
    s, scale = _axis(samples)
    pairs = order - order % 2
    if wanted == order + 1 and order % 2 == 0:
        middle = scale * float(np.sqrt(np.abs(s).min() * np.abs(s).max()))
        return np.concatenate([before.theta[:pairs], [np.log(middle)], before.theta[pairs:]])
    nf = s.size
    miss = (before.residual[:, :nf] ** 2 + before.residual[:, nf:] ** 2).sum(axis=0)
    at = float(np.abs(s[int(np.argmax(np.convolve(miss, np.ones(SMOOTHED), mode="same")))])) * scale
    pair = np.array([np.log(2 * DAMPING * at), 2 * np.log(at)])
    # From an odd order to the next even one the single pole is given up.
    kept = before.theta[order:] if wanted == order + 1 else before.theta[pairs:]
    return np.concatenate([before.theta[:pairs], pair, kept])


def _axis(samples: sections.FrequencySamples) -> tuple[ComplexArray, float]:
    """Return points on the imaginary axis scaled to near one, and the scale in units of the sections."""
    if samples.rate_hz is None:
        return np.asarray(1j * samples.f_rad / samples.scale, dtype=np.complex128), 1.0
    w = np.tan(samples.f_rad / samples.rate_hz / 2)
    scale = float(np.median(w))
    return np.asarray(1j * w / scale, dtype=np.complex128), scale
