"""One pass of sweeps over a band, open loop and closed: S, and what noise and ringing leave open of it."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sensitivity.neighbours import together
from ultraquiet.simulate.sweeps.band import OpenBand
from ultraquiet.simulate.sweeps.lines import inverted, largest
from ultraquiet.simulate.sweeps.runs import Runs, noise_rows, still_moving

ROUNDING = 1e-9  # what is left of a deviation without noise


@dataclass(frozen=True, eq=False)
class LeftOpen:
    """What is left open of the largest singular value of S, each `(lines,)`.

    `closed`, `opened`: by the noise of either loop; `moving`, `opened_moving`: by runs of either that had not come to
    rest. Noise of the closed loop alone falls with each pass: the open loop's runs are the same in all of them.
    """

    closed: FloatArray
    opened: FloatArray
    moving: FloatArray
    opened_moving: FloatArray

    @property
    def noise(self) -> FloatArray:
        """By the noise of the closed loop and of the open one, `(2, lines)`."""
        return np.stack([self.closed, self.opened])

    @property
    def all_moving(self) -> FloatArray:
        """By runs of both loops that had not come to rest."""
        return np.hypot(self.moving, self.opened_moving)

    @property
    def deviation(self) -> FloatArray:
        """By all of it."""
        return together(self.noise, self.all_moving)

    def averaged(self, other: "LeftOpen", share: FloatArray) -> "LeftOpen":
        """Return what is left open once another pass has this share."""
        rest = 1 - share
        return LeftOpen(
            np.hypot(rest * self.closed, share * other.closed),
            rest * self.opened + share * other.opened,
            rest * self.moving + share * other.moving,
            rest * self.opened_moving + share * other.opened_moving,
        )


class OnePass:
    """What one pass over a band shows.

    Both loops' sweeps differ in level, so the open response is taken to what was sent with the law,

        S = Yc R^+,   R = Yo Do^+ Dc.

    Attributes: S `(lines, ny, ny)`; `answers` R `(lines, ny, k)`; `closed_rows`, `opened_rows`: noise of either loop at
    each sensor beside R, `(ny, lines)`; `left`: what is left open of S; `response`: of the closed loop.
    """

    def __init__(self, band: OpenBand, closed: Runs, noise: FloatArray) -> None:
        opened = band.runs
        Do, Dc, Yo, Yc = (np.moveaxis(x, 2, 0) for x in (opened.sent, closed.sent, opened.heard, closed.heard))
        turn = inverted(Do) @ Dc
        self.answers = Yo @ turn
        inverse = inverted(self.answers)
        self.S = Yc @ inverse
        self.response = np.moveaxis(Yc @ inverted(Dc), 0, 2).astype(np.complex128)
        # A quiet run with the law is shorter than its loop may ring, its lines wider than a peak of S: what the loop
        # makes of the open noise is known from S itself, line by line.
        filtered = _through(self.S, noise_rows(closed, band.noise))
        noisy = np.maximum(noise_rows(closed, noise), filtered)
        self.closed_rows = noisy + ROUNDING * np.linalg.norm(Yc, axis=2).T
        by_open = noise_rows(opened, band.noise)
        self.opened_rows = largest(turn) * _through(self.S, by_open)
        weakest, both = largest(inverse), largest(self.S) * largest(turn @ inverse)
        self.left = LeftOpen(
            weakest * np.linalg.norm(self.closed_rows, axis=0),
            both * np.linalg.norm(by_open, axis=0),
            weakest * still_moving(closed),
            both * still_moving(opened),
        )


def _through(S: ComplexArray, rows: FloatArray) -> FloatArray:
    """Return the noise that S `(lines, ny, ny)` makes of independent noise `(ny, lines)` at each sensor, likewise."""
    return np.sqrt(np.einsum("lij,jl->il", np.abs(S) ** 2, rows**2))
