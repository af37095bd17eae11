"""Where tunable elements stand in a controller: K = sum over places of L k R, elements shared between them or not."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.law_structure.elements import Element
from ultraquiet.design.law_structure.plane import Plane
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class Placement:
    """Element number `element` between rows R `(c, ny)` of the readings and columns L `(nu, r)` of the commands."""

    element: int
    left: FloatArray
    right: FloatArray


@dataclass(frozen=True, eq=False)
class ControllerStructure:
    """A controller K = sum L k_e(theta) R; the parameters of all elements follow each other in theta."""

    elements: tuple[Element, ...]
    placements: tuple[Placement, ...]

    @property
    def edges(self) -> list[int]:
        """Where the parameters of each element begin and the last ends."""
        return [0, *np.cumsum([e.size for e in self.elements]).tolist()]

    def parts(self, theta: FloatArray) -> list[FloatArray]:
        """Return the parameters of each element."""
        edges = self.edges
        return [theta[a:b] for a, b in itertools.pairwise(edges)]

    def response(self, theta: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return K `(frequency, nu, ny)`."""
        own = [e.response(t, s) for e, t in zip(self.elements, self.parts(theta), strict=True)]
        first = self.placements[0]
        K = np.zeros((s.size, first.left.shape[0], first.right.shape[1]), dtype=np.complex128)
        for each, places in zip(own, self._places, strict=True):
            if each.shape[1:] == (1, 1):
                K += each * sum(p.left @ p.right for p in places)
            else:
                for p in places:
                    K += p.left @ each @ p.right
        return K

    def gradient(self, theta: FloatArray, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return left (dK / dtheta) right for each frequency, left `(nf, nu)`, right `(nf, ny)`."""
        out: list[ComplexArray] = []
        for element, part, places in zip(self.elements, self.parts(theta), self._places, strict=True):
            sides = [(left @ p.left, right @ p.right.T) for p in places]
            if element.shape == (1, 1):
                # left k right is k times a number, and numbers add up over the places
                total = np.sum([one * other for one, other in sides], axis=0) + np.zeros((s.size, 1))
                sides = [(total, np.ones((s.size, 1), dtype=np.complex128))]
            nothing = np.zeros((s.size, element.size), dtype=np.complex128)
            out.append(sum((element.gradient(part, s, *side) for side in sides), nothing))
        return np.concatenate(out, axis=1)

    @cached_property
    def _places(self) -> list[list[Placement]]:
        """Where each element stands."""
        return [[p for p in self.placements if p.element == k] for k in range(len(self.elements))]

    @property
    def lowest(self) -> FloatArray:
        """Least values of the parameters, minus infinity for those that have none."""
        none = [np.full(e.size, -np.inf) for e in self.elements]
        return np.concatenate([getattr(e, "lowest", free) for e, free in zip(self.elements, none, strict=True)])

    def system(self, theta: FloatArray) -> Matrices:
        """Return A, B, C, D of the whole controller in the plane, place after place."""
        return self._placed([e.system(t) for e, t in zip(self.elements, self.parts(theta), strict=True)])

    def law(self, theta: FloatArray, plane: Plane) -> StateSpace:
        """Return the controller that has these parameters in a plane.

        Each element leaves the plane by itself: copies of one are equal to the last digit, whatever their places.
        """
        own = [plane.from_plane(e.system(t)) for e, t in zip(self.elements, self.parts(theta), strict=True)]
        return StateSpace(*self._placed([(k.A, k.B, k.C, k.D) for k in own]), rate_hz=plane.rate_hz)

    def _placed(self, own: list[Matrices]) -> Matrices:
        """Return A, B, C, D of elements that are made of these, each at its places."""
        sizes = [own[p.element][0].shape[0] for p in self.placements]
        A, at = np.zeros((sum(sizes), sum(sizes))), 0
        for p, n in zip(self.placements, sizes, strict=True):
            A[at : at + n, at : at + n] = own[p.element][0]
            at += n
        B = np.vstack([own[p.element][1] @ p.right for p in self.placements])
        C = np.hstack([p.left @ own[p.element][2] for p in self.placements])
        D = np.sum([p.left @ own[p.element][3] @ p.right for p in self.placements], axis=0)
        return A, B, C, D

    def abscissa(self, theta: FloatArray) -> float:
        """Return the largest real part of the controller's own poles; minus infinity without states."""
        poles = [np.linalg.eigvals(e.system(t)[0]).real for e, t in zip(self.elements, self.parts(theta), strict=True)]
        return float(max((p.max() for p in poles if p.size), default=-np.inf))

    def start(self, rng: np.random.Generator, low: float, high: float) -> FloatArray:
        """Return a random start."""
        return np.concatenate([e.start(rng, low, high) for e in self.elements])


def one_element(element: Element) -> ControllerStructure:
    """Return the controller that is one element."""
    r, c = element.shape
    return ControllerStructure((element,), (Placement(0, np.eye(r), np.eye(c)),))


def repeated(element: Element, channels: int, transform: FloatArray | None = None) -> ControllerStructure:
    """Return the same scalar element on each channel, or on each column of an orthonormal transform."""
    T = np.eye(channels) if transform is None else transform
    return ControllerStructure((element,), tuple(Placement(0, T[:, [k]], T[:, [k]].T) for k in range(channels)))


def decentralised(elements: tuple[Element, ...], channels: int) -> ControllerStructure:
    """Return an element of its own on each channel."""
    one = np.eye(channels)
    return ControllerStructure(elements, tuple(Placement(k, one[:, [k]], one[[k]]) for k in range(channels)))
