"""Nonlinear distortion seen at lines that were not excited: odd and even kinds told apart."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen

# Levels are averaged over so many lines on each side before one is taken over to an excited line.
NEIGHBOURS = 5
# Averaged over a band, distortion this many times the noise is no chance.
VISIBLE = 1.5


@dataclass(frozen=True, eq=False)
class Detection:
    """Output power at unexcited lines inside the excited band, noise taken off.

    Attributes:
        odd_hz, even_hz: lines that odd (saturation, hysteresis) and even (offset-like) distortion reach.
        odd, even: `(ny, lines)` distortion power of one realisation there, squared modulus of the DFT of one period
            over the squared half period: a line of amplitude A has A^2. May be below zero by chance.
        odd_noise, even_noise: `(ny, lines)` power of the noise in the mean of the periods, likewise.
        signal: `(ny,)` mean power of the excited lines, likewise.
    """

    odd_hz: FloatArray
    even_hz: FloatArray
    odd: FloatArray
    even: FloatArray
    odd_noise: FloatArray
    even_noise: FloatArray
    signal: FloatArray
    odd_lines: np.ndarray
    half_period: float

    @property
    def sentence(self) -> str:
        """Which kind stands above noise, against the response, for the output where it is worst."""
        findings = []
        for name, level, noise in (("odd", self.odd, self.odd_noise), ("even", self.even, self.even_noise)):
            if not level.size:
                continue
            mean, floor = level.mean(axis=1), noise.mean(axis=1)
            audible = mean > VISIBLE * floor
            if audible.any():
                worst = 10 * np.log10(np.max(np.where(audible, mean / self.signal, 0.0)))
                findings.append(f"{name} distortion {worst:.0f} dB of the response")
            else:
                findings.append(f"no {name} distortion above noise")
        return f"At unexcited lines: {', '.join(findings)}."

    def carried_to(self, lines: np.ndarray) -> FloatArray:
        """Return the odd distortion at excited lines, `(ny, lines)`, as squared modulus of one period's DFT."""
        out = np.empty((self.odd.shape[0], lines.size))
        for n, k in enumerate(lines):
            near = np.argsort(np.abs(self.odd_lines - k), kind="stable")[: 2 * NEIGHBOURS]
            out[:, n] = self.odd[:, near].mean(axis=1)
        return np.maximum(out, 0.0) * self.half_period**2


def detection(
    experiments: list[tuple[ComplexArray, ComplexArray]], lines: np.ndarray, line_hz: float
) -> Detection | None:
    """Return the distortion at unexcited lines between the first and the last excited one; None without such lines.

    Odd multisines alone tell the kinds apart: when even lines are excited too, both kinds land everywhere, and the
    unexcited lines say nothing of either by itself.
    """
    inner = np.setdiff1d(np.arange(lines[0], lines[-1] + 1), lines)
    if np.any(lines % 2 == 0) or not np.any(inner % 2 == 0):
        return None
    period = 2 * (experiments[0][0].shape[2] - 1)
    odd, even = inner[inner % 2 == 1], inner[inner % 2 == 0]
    parts = [_levels(U, Y, lines, inner) for U, Y in experiments]
    power = np.mean([p for p, _ in parts], axis=0)
    noise = np.mean([n for _, n in parts], axis=0)
    half = period / 2
    is_odd = inner % 2 == 1
    level, floor = (power - noise) / half**2, noise / half**2
    signal = np.mean([np.abs(Y.mean(axis=1)[:, lines]) ** 2 for _, Y in experiments], axis=(0, 2)) / half**2
    return Detection(
        frozen(odd * line_hz),
        frozen(even * line_hz),
        frozen(level[:, is_odd]),
        frozen(level[:, ~is_odd]),
        frozen(floor[:, is_odd]),
        frozen(floor[:, ~is_odd]),
        frozen(signal),
        frozen(odd),
        half,
    )


def _levels(U: ComplexArray, Y: ComplexArray, lines: np.ndarray, inner: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return power and noise power of the mean period at the unexcited lines, `(ny, inner)`.

    What a measured input holds there is no distortion of the plant; with one moving input it is taken off by the
    response interpolated between excited lines, to first order (Pintelon and Schoukens 2012, section 4.3.3).
    """
    out = Y[:, :, inner]
    moving = [j for j in range(U.shape[0]) if np.abs(U[j][:, lines]).max() > 0]
    if len(moving) == 1:
        u = U[moving[0]].mean(axis=0)
        G = Y.mean(axis=1)[:, lines] / u[lines]
        for i in range(Y.shape[0]):
            between = np.interp(inner, lines, G[i].real) + 1j * np.interp(inner, lines, G[i].imag)
            out = out.copy() if i == 0 else out
            out[i] = out[i] - between * U[moving[0]][:, inner]
    P = out.shape[1]
    return np.abs(out.mean(axis=1)) ** 2, out.var(axis=1, ddof=1) / P
