"""What is assumed of a model's error where nothing was measured: below the lowest line and above the highest."""

from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.response import principal_gains

REACH = 30.0  # times below the lowest line and above the highest: as far as a weight's corners may lie
POINTS = 40  # on either side
OCTAVE = 2.0


def outside_lines(f_hz: FloatArray, rate_hz: float | None) -> tuple[FloatArray, FloatArray]:
    """Return frequencies below the lowest positive line and above the highest, up to Nyquist where there is one."""
    first = float(f_hz[f_hz > 0][0]) if np.any(f_hz > 0) else 0.0
    last = float(f_hz[-1])
    below = np.geomspace(first / REACH, first, POINTS + 1)[:-1] if f_hz[0] > 0 else np.zeros(0)
    top = REACH * last if rate_hz is None else np.nextafter(rate_hz / 2, 0.0)
    above = np.geomspace(last, top, POINTS + 1)[1:] if last < top and last > 0 else np.zeros(0)
    return below, above


def held(f_hz: FloatArray, errors: ComplexArray, nominal: Any, kind: str) -> tuple[FloatArray, FloatArray]:
    """Return f and radius outside the lines, the absolute error held at what it is over the nearest octave of them.

    The error is held, not its ratio to the model: what is left at the end of a record is noise, which knows nothing of
    how the model goes on. A relative radius is then the held error over the model's largest gain; a direction in which
    the model is weaker than in its strongest is known less well by as much, which no scalar bound could carry.

    Args:
        f_hz: `(nf,)` the lines.
        errors: `(others, ny, nu, nf)` G_other - G.
        nominal: the model, which has a response at any frequency.
        kind: of `Uncertainty`.

    Returns:
        `(k,)`, and `(k,)` or `(ny, nu, k)` for the kinds by entry.
    """
    entry = kind.endswith("entry")
    if entry:
        sizes = np.abs(errors).max(axis=0)
    else:
        sizes = np.linalg.norm(np.moveaxis(errors, -1, 1), 2, axis=(2, 3)).max(axis=0)
    sides = outside_lines(f_hz, nominal.rate_hz)
    near = (f_hz <= OCTAVE * f_hz[0], f_hz >= f_hz[-1] / OCTAVE)
    radii = [
        _side(f, np.median(sizes[..., n], axis=-1), nominal, kind, entry) for f, n in zip(sides, near, strict=True)
    ]
    return np.concatenate(sides), np.concatenate(radii, axis=-1)


def _side(f: FloatArray, size: FloatArray, nominal: Any, kind: str, entry: bool) -> FloatArray:
    level = np.asarray(size)[..., None] * np.ones(f.size)
    if kind.startswith("additive") or not f.size:
        return level
    G = nominal.frequency_response(f)
    gain = np.abs(G) if entry else principal_gains(G)[0]
    least = np.finfo(float).tiny
    return level / np.maximum(gain, np.maximum(gain.max(axis=-1, keepdims=True) * np.finfo(float).eps, least))


def told(measured: bool, f_hz: FloatArray, outside: FloatArray) -> str:
    """Say between which lines the bound was measured, and what is assumed outside; nothing of a bound without lines."""
    if not measured:
        return ""
    ends = f" Nothing was measured outside {f_hz[0]:g}-{f_hz[-1]:g} Hz"
    if not outside.size:
        return f"{ends}, and nothing is known there."
    return (
        f"{ends}: there the absolute error is assumed to stay what it is over the nearest octave of lines, in relation "
        "to the model's strongest direction; a weaker direction is not known that well."
    )
