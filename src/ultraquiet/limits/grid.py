"""Where a limit is sought: the poles of its functions and the frequencies at which its demands are put."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.limits.circle import Circle

# Poles at an edge of the band lie at this share of its frequency from the axis, halved from one to the next: such a
# sequence follows a jump with an error that falls with the exponential of its length (as rational functions do |x|).
EDGE, EDGE_STEP = 0.7, 0.5
# A band narrower than its lower edge lies closer: poles at this share of its width, and more of them to an octave, for
# such a band is deeper and |S| the steeper at its edges.
NARROW_STEP = 0.7
BROAD = np.exp(1j * np.radians(120))  # damping 0.5 of the poles that are spread over the axis
LEAST_DAMPING = 0.01
ALIKE = 0.02
SPREAD_BELOW, SPREAD_ABOVE = 4.0, 0.9  # of the lower edge; of the Nyquist frequency
CONTINUOUS_ABOVE = 100.0  # times the upper edge, where there is no Nyquist frequency
NEAREST = 1e-4  # of an edge's frequency, the nearest pole; the grid comes a hundred times nearer
EVEN, AROUND_EDGE, AROUND_ROOT = 1200, 90, 41
FINER = 4  # times as many points, to look between those of a grid


def is_narrow(band_hz: tuple[float, float]) -> bool:
    """Return whether a band is narrower than its lower edge."""
    return band_hz[1] - band_hz[0] < band_hz[0]


def basis_poles(
    roots: ComplexArray, circle: Circle, band_hz: tuple[float, float], size: int, narrow: bool = False
) -> ComplexArray:
    """Return about `size` states' worth of poles on the disc: the plant's, edges of the band, spread, and delays.

    Args:
        roots: poles and zeros of the plant in the half-plane, rad/s: Q inverts the plant where S is small.
        circle: the warped circle.
        band_hz: the band.
        size: wanted number of states; the plant's own come on top.
        narrow: whether poles at an edge go by the width of the band and not by the frequency of the edge.
    """
    own = _apart(roots[np.isfinite(roots) & (roots.imag >= 0)])
    own = -np.maximum(np.abs(own.real), LEAST_DAMPING * np.abs(own)) + 1j * own.imag
    # of three pairs and a bit, one goes to each edge and one over the axis; the rest are samples of delay
    pairs = max(1, size // 7)
    at = _rad(circle, np.array(band_hz))
    reach = np.full(2, at[1] - at[0]) if narrow else at
    step = NARROW_STEP if narrow else EDGE_STEP
    shares = np.geomspace(EDGE, max(NEAREST, EDGE * step ** (pairs - 1)), pairs)
    edges = [1j * e - share * r for share in shares for e, r in zip(at, reach, strict=True)]
    top = CONTINUOUS_ABOVE * band_hz[1] if circle.rate_hz is None else SPREAD_ABOVE * circle.rate_hz / 2
    spread = BROAD * _rad(circle, np.geomspace(band_hz[0] / SPREAD_BELOW, top, pairs + pairs // 3))
    quick = np.full(max(1, size - 6 * pairs), -_quickest(circle, top), dtype=np.complex128)
    return circle.roots(np.concatenate([own, edges, spread, quick]))


def frequencies(roots: ComplexArray, circle: Circle, band_hz: tuple[float, float]) -> FloatArray:
    """Return frequencies in Hz, dense in angle, in octaves, around edges and around the roots of the plant."""
    angles = np.linspace(0, np.pi, EVEN)
    even = circle.frequencies(angles)
    top = even[-1] if circle.rate_hz else 10 * CONTINUOUS_ABOVE * band_hz[1]
    near = np.geomspace(NEAREST / 100, 0.5, AROUND_EDGE)
    parts = [even, np.geomspace(band_hz[0] / 30, top, EVEN), np.array(band_hz)]
    parts += [e * (1 + sign * near) for e in band_hz for sign in (-1, 1)]
    for s in _apart(roots[np.isfinite(roots) & (roots.imag > 0)]):
        width = max(abs(s.real / abs(s)), 1e-3)
        at = _hertz(circle, abs(s) * (1 + width * np.linspace(-4, 4, AROUND_ROOT)))
        parts.append(at)
    f = np.unique(np.concatenate(parts))
    return f[(f >= 0) & (f <= even[-1])]


def finer(f_hz: FloatArray) -> FloatArray:
    """Return the grid with three points more between every two."""
    at = np.arange(f_hz.size * FINER - FINER + 1) / FINER
    return np.interp(at, np.arange(f_hz.size), f_hz)


def _apart(roots: ComplexArray) -> ComplexArray:
    """Return one of every group of roots that hardly differ."""
    kept: list[complex] = []
    for s in roots:
        if s and all(abs(s - other) > ALIKE * abs(s) for other in kept):
            kept.append(complex(s))
    return np.array(kept, dtype=np.complex128)


def _quickest(circle: Circle, top_hz: float) -> float:
    """Return the decay in rad/s of a sample's delay, z = 0; that of the highest frequency in continuous time."""
    return 2 * circle.rate_hz if circle.rate_hz else 2 * np.pi * top_hz


def _rad(circle: Circle, f_hz: FloatArray) -> FloatArray:
    return circle.speed * np.tan(circle.angles(f_hz) / 2)


def _hertz(circle: Circle, rad: FloatArray) -> FloatArray:
    return circle.frequencies(2 * np.arctan(np.abs(rad) / circle.speed))
