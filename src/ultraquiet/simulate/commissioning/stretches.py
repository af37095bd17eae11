"""Stretches of one response, driven each as loud as it may be, that overlap: none begins where another ends."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.commissioning.injection import Injection, MeasuredResponse, lines_over

OVERLAP = 1.3  # about an edge both stretches are heard, from so many times below to so many times above


def stretches(
    edges_hz: Sequence[float], seconds: Sequence[float], per_octave: Sequence[int], rate_hz: float
) -> list[Injection]:
    """Return an injection for each stretch between edges, the same lines of both about an edge.

    Args:
        edges_hz: rising, where stretches begin and end.
        seconds: a period of each stretch, whole multiples of the shortest.
        per_octave: lines of each.
        rate_hz: of the samples.
    """
    shared = round(min(seconds) * rate_hz)
    common = [
        lines_over((edge / OVERLAP, edge * OVERLAP), max(both), shared, rate_hz)
        for edge, both in zip(edges_hz[1:-1], pairwise(per_octave), strict=True)
    ]
    none = np.zeros(0)
    made: list[Injection] = []
    for k, ((low, high), period, density) in enumerate(zip(pairwise(edges_hz), seconds, per_octave, strict=True)):
        n = shared * round(period / min(seconds))
        begin = low if k == 0 else low * OVERLAP
        end = high if k == len(common) else high / OVERLAP
        own = lines_over((begin, end), density, n, rate_hz) if begin < end else none
        beside = [(n // shared) * (common[j] if 0 <= j < len(common) else none) for j in (k - 1, k)]
        lines = np.unique(np.concatenate([beside[0], own, beside[1]]))
        if lines.size:
            made.append(Injection.at(lines, n, rate_hz))
    return made


def blended(parts: Sequence[MeasuredResponse], longest_s: float) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return lines, response and variance of all stretches; where two were heard, the one fades into the other.

    A plant that is not linear answers each level differently. A response that jumped from one to the other would ask
    for modes that the plant does not have, as sharp as the lines are close.

        G = (1 - w) G_low + w G_high,   var G = (1 - w)^2 var G_low + w^2 var G_high,

    where w rises from 0 to 1 with the logarithm of frequency, over the lines that both have. `longest_s`: the longest
    period, of which every line is a whole number.
    """
    f, G, variance = parts[0].f_hz, parts[0].G, parts[0].variance
    for part in parts[1:]:
        both, at, its = np.intersect1d(np.rint(f * longest_s), np.rint(part.f_hz * longest_s), return_indices=True)
        w = np.full(both.size, 0.5) if both.size < 2 else np.log(both / both[0]) / np.log(both[-1] / both[0])
        merged = (1 - w) * G[:, :, at] + w * part.G[:, :, its]
        spread = (1 - w) ** 2 * variance[:, :, at] + w**2 * part.variance[:, :, its]
        before, after = np.setdiff1d(np.arange(f.size), at), np.setdiff1d(np.arange(part.f_hz.size), its)
        lines = np.concatenate([f[before], f[at], part.f_hz[after]])
        order = np.argsort(lines, kind="stable")
        f = lines[order]
        G = np.concatenate([G[:, :, before], merged, part.G[:, :, after]], axis=2)[:, :, order]
        variance = np.concatenate([variance[:, :, before], spread, part.variance[:, :, after]], axis=2)[:, :, order]
    return f, G, variance
