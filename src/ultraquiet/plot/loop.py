"""A loop as figures: singular values of S, T and KS, and the loci of the open loop's eigenvalues."""

from collections.abc import Mapping, Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.plot.figure import Figure, Line, Panel

HZ = "frequency (Hz)"
FLOOR = 1e-6  # of the largest: what is smaller is rounding, and stands at the foot of the axis
SPAN = 3.0  # of the plane about the critical point: further out a locus says nothing of stability
CROSS = 0.08  # size of the mark there


def sensitivity_figure(
    name: str,
    f_hz: FloatArray,
    members: Mapping[str, FloatArray],
    units: Mapping[str, str],
    band_hz: tuple[float, float],
) -> Figure:
    """Singular values `(directions, nf)` of each member of a loop; the band is shaded, `units` follow "dB"."""
    panels = [
        Panel(
            [Line.of(f_hz, _db(each, values), shade=k) for k, each in enumerate(values)],
            f"{member} of {name}",
            HZ,
            f"dB{units.get(member, '')}",
            x_log=True,
            spans=[band_hz],
        )
        for member, values in members.items()
    ]
    caption = (
        f"Singular values of {', '.join(members)} of {name}: the largest is the worst direction; "
        f"{band_hz[0]:.4g} to {band_hz[1]:.4g} Hz shaded."
    )
    return Figure("sensitivity", f"The loop of {name}", caption, panels, 1, (8.0, 2.6 * len(panels)))


def _db(each: FloatArray, values: FloatArray) -> FloatArray:
    largest = float(values.max(initial=0.0)) or 1.0
    return 20 * np.log10(np.maximum(each, FLOOR * largest))


def nyquist_figure(name: str, loop: ComplexArray) -> Figure:
    """Eigenvalue loci of -L, L = G K or K G `(channels, channels, nf)` over rising frequencies, about -1."""
    loci = tracked(-np.linalg.eigvals(np.moveaxis(loop, 2, 0)).astype(np.complex128))
    lines = [Line(np.real(each), np.imag(each), f"locus {k + 1}", shade=k) for k, each in enumerate(loci)]
    mark = [
        Line(np.array([-1.0 - CROSS, -1.0 + CROSS]), np.array([-CROSS, CROSS]), "critical point", shade=6),
        Line(np.array([-1.0 - CROSS, -1.0 + CROSS]), np.array([CROSS, -CROSS]), shade=6),
    ]
    span = (-SPAN, SPAN)
    panel = Panel([*lines, *mark], "", "real part", "imaginary part", x_range=span, y_range=span)
    caption = f"Eigenvalues of -G K of {name} for rising frequency; their encirclements of -1 decide on stability."
    return Figure("nyquist", f"Eigenvalue loci of {name}", caption, [panel], 1, (6.0, 6.0))


def tracked(values: ComplexArray) -> Sequence[ComplexArray]:
    """Return `(nf, k)` numbers as k curves: each goes on with the value nearest to it.

    >>> [curve.real.tolist() for curve in tracked(np.array([[1.0, 5.0], [5.1, 1.1]], complex))]
    [[1.0, 1.1], [5.0, 5.1]]
    """
    from scipy.optimize import linear_sum_assignment

    rows = [values[0]]
    for following in values[1:]:
        order = linear_sum_assignment(np.abs(rows[-1][:, None] - following[None, :]))[1]
        rows.append(following[order])
    return list(np.array(rows).T)
