"""Levels that count as reached: a controller was built, its loop closed with the plant as given, its norm measured."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.constraints import ComplexArray
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design.hinf import discrete_riccati, riccati
from ultraquiet.design.hinf.problem.units import EvenProblem
from ultraquiet.design.result import is_stable
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.linalg.even import even_states, untangled
from ultraquiet.linalg.norms import peak_gain
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.linalg.response import JoinedGain
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace

KEPT = 1e-3  # a level is kept when the norm exceeds it by no more than this share
MEASURED = 1e-6  # accuracy of the norms that levels are compared by, of which the finest share is ten times that
TOLD = 1e-7  # accuracy of the norm that is told of the controller chosen


class Reached(NamedTuple):
    """A controller that was verified: the level it was made for, the norm it gives and where, in units of the plant."""

    controller: StateSpace
    achieved: float
    f_hz: float
    poles: ComplexArray
    bound: float
    level: riccati.Level | None  # None where the other route made it

    @property
    def keeps(self) -> bool:
        """Whether the norm is at most the level it was made for."""
        return self.achieved <= self.bound * (1 + KEPT)


@dataclass
class Verifier:
    """Makes controllers at levels and measures what they give; keeps the best.

    Attributes:
        P: generalised plant as it was given.
        problem: the same in even units.
        even: the system that the equations are written for: `problem.plant`, perhaps without hidden states.
        plant: `even` normalised, continuous.
        ny, nu: sizes of y and u.
        best: the controller with the smallest norm so far.
        said: why the last level failed.
        shown: whether that shows it to be out of reach; else an equation was not solved or a loop fell short.
        searched: levels (of the even problem) under which an earlier search found nothing, and showed that nothing is.
    """

    P: StateSpace
    problem: EvenProblem
    even: StateSpace
    ny: int
    nu: int
    plant: riccati.NormalisedPlant = field(init=False)
    best: Reached | None = None
    said: str = ""
    shown: bool = False
    searched: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self.plant = self._normalised(in_parts=False)

    def _normalised(self, in_parts: bool) -> riccati.NormalisedPlant:
        M = (self.even.A, self.even.B, self.even.C, self.even.D)
        continuous = M if self.even.rate_hz is None else bilinear_to_continuous(*M)
        return riccati.normalise(continuous, self.ny, self.nu, in_parts)

    def in_parts(self) -> bool:
        """Put the states into other coordinates, where no level was solved; return whether there are any."""
        before, self.plant = self.plant, self._normalised(in_parts=True)
        return self.plant.form.blocks != before.form.blocks

    def at(self, gamma: float, known: riccati.Level | None = None) -> Reached | None:
        """Return what the central controller of a level (of the even problem) gives; None where there is none."""
        self.shown = False
        level = known if known is not None and known.gamma == gamma else riccati.attempt(self.plant, gamma)
        if level.reason:
            self.said, self.shown = level.reason, level.proof
            return None
        try:
            M = riccati.central(self.plant, level)
            K = M if self.even.rate_hz is None else bilinear_to_discrete(*M)
            return self._closed(K, level.gamma, level)
        except (NumericalError, InputError, LinAlgError) as error:
            self.said = str(error)
            return None

    def beside(self, gamma: float) -> Reached | None:
        """Return what direct discrete synthesis gives at a level of the even problem: other equations altogether."""
        M = (self.even.A, self.even.B, self.even.C, self.even.D)
        speed, self.shown, self.said = 1.0, False, ""
        try:
            if self.even.rate_hz is None:
                speed = discrete_riccati.aside(self.even.poles())
                root = np.sqrt(speed)
                M = bilinear_to_discrete(M[0] / speed, M[1] / root, M[2] / root, M[3])
            K, _ = discrete_riccati.central(M, self.ny, self.nu, gamma)
            if self.even.rate_hz is None:
                A, B, C, D = bilinear_to_continuous(*K)
                K = (A * speed, B * np.sqrt(speed), C * np.sqrt(speed), D)
            return self._closed(K, gamma, None)
        except (NumericalError, InputError, LinAlgError) as error:
            self.said, self.shown = str(error), isinstance(error, discrete_riccati.OutOfReachError)
            return None

    def finely(self, found: Reached) -> Reached:
        """Return it with its norm measured ten times as well: peaks so flat that a comparison passes them by count.

        And of the plant and the law as they are: the rounding of a joined loop's matrices may count for more. Any gain
        bounds a norm from below, so where this search passes by the peak found before, the gain there is told.
        """
        P, K = self.P, found.controller
        loop = _evened(lft(P, K))
        exact = JoinedGain((P.A, P.B, P.C, P.D), (K.A, K.B, K.C, K.D))
        achieved, w = peak_gain(loop.A, loop.B, loop.C, loop.D, P.rate_hz is not None, TOLD, exact)
        if not np.isfinite(achieved):
            return found
        # a first peak at infinity needs no second look: every search begins with the gain there
        if np.isfinite(found.f_hz):
            before = 2j * np.pi * found.f_hz
            gain = exact(before if P.rate_hz is None else np.exp(before / P.rate_hz))
            if gain > achieved:
                return found._replace(achieved=gain)
        return found._replace(achieved=achieved, f_hz=w / (2 * np.pi) * (P.rate_hz or 1.0))

    def _closed(self, K: Matrices, gamma: float, level: riccati.Level | None) -> Reached | None:
        law = self.problem.law(StateSpace(*untangled(*K[:3]), K[3], rate_hz=self.P.rate_hz))
        loop = _evened(lft(self.P, law))
        poles = loop.poles()
        bound = gamma / self.problem.level
        if not is_stable(poles, self.P.rate_hz):
            self.said = f"the loop at level {bound:.6g} is unstable"
            return None
        achieved, f_hz = hinf_norm(loop, MEASURED)
        if not np.isfinite(achieved):
            self.said = f"the loop at level {bound:.6g} is on the border of stability"
            return None
        found = Reached(law, achieved, f_hz, poles, bound, level)
        if not found.keeps:
            self.said = f"the loop at level {bound:.6g} has the norm {achieved:.6g}"
        if self.best is None or achieved < self.best.achieved:
            self.best = found
        return found


def _evened(G: StateSpace) -> StateSpace:
    return StateSpace(*even_states(G.A, G.B, G.C)[:3], G.D, G.rate_hz)
