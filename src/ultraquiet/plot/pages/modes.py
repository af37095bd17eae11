"""The modes of a model as shapes that move: on the bench's sketch, or its readings in a row."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray
from ultraquiet._base.shown.line import counted, several_of
from ultraquiet.chart import MovingShape, Scene
from ultraquiet.values import StateSpace
from ultraquiet.values.sketch import Sketch, row_of

MOST_MODES = 6
MOST_DAMPING = 0.3  # beyond, nothing swings


@dataclass(frozen=True, eq=False)
class SeenMode:
    """A mode: frequency in Hz, damping, how strongly it answers, its shape `(ny,)` at the sensors, largest entry 1."""

    f_hz: float
    zeta: float
    size: float
    shape: ComplexArray


def strongest_modes(plant: StateSpace, limits_hz: tuple[float, float], most: int = MOST_MODES) -> list[SeenMode]:
    """Return the lightly damped modes that answer most, by frequency.

    With A v = z v and w the rows of the inverse of all v, the mode's part of the response is C v w B / (e^jw - z); its
    peak is |C v| |w B| / (1 - |z|). Readings of unlike units are compared each with the largest of its own.

    Args:
        plant: discrete, `(ny, nu)`.
        limits_hz: between which frequencies.
        most: how many.
    """
    rate_hz = plant.rate_hz
    if rate_hz is None or not plant.states:
        return []
    values, vectors = np.linalg.eig(plant.A)
    z, V = values.astype(np.complex128), vectors.astype(np.complex128)
    if np.linalg.cond(V) > 1.0 / np.finfo(float).eps:  # no basis of shapes: a defective matrix
        return []
    into, out = np.linalg.solve(V, plant.B), plant.C @ V
    own = np.array([[c.unit == d.unit for d in plant.sensors] for c in plant.sensors])
    found = []
    for k in np.flatnonzero((z.imag > 0) & (np.abs(z) < 1)):
        s = np.log(z[k]) * rate_hz
        f, zeta = abs(s) / (2 * np.pi), -s.real / abs(s)
        if not (limits_hz[0] <= f <= limits_hz[1] and zeta < MOST_DAMPING):
            continue
        size = float(np.linalg.norm(out[:, k]) * np.linalg.norm(into[k]) / (1 - abs(z[k])))
        group = np.array([np.abs(out[same, k]).max() for same in own])
        shape = out[:, k] / np.where(group > 0, group, 1.0)
        turn = np.angle(np.sum(shape**2)) / 2
        found.append(SeenMode(float(f), float(zeta), size, (shape * np.exp(-1j * turn)).astype(np.complex128)))
    return sorted(sorted(found, key=lambda mode: -mode.size)[:most], key=lambda mode: mode.f_hz)


def mode_shapes(plant: StateSpace, limits_hz: tuple[float, float], sketch: Sketch | None = None) -> Scene | None:
    """Return the strongest modes, moving; None where none is lightly damped.

    Args:
        plant: the design model.
        limits_hz: between which frequencies.
        sketch: of the bench, where it has one that moves with the model's readings; else they stand in a row.
    """
    modes = strongest_modes(plant, limits_hz)
    if not modes:
        return None
    known = sketch is not None and sketch.moves.shape[2] == len(plant.sensors)
    drawn = sketch if sketch is not None and known else row_of(len(plant.sensors))
    shapes = []
    for mode in modes:
        moves = drawn.moves @ mode.shape
        moves = moves / max(float(np.abs(moves).max()), np.finfo(float).tiny)
        shapes.append(MovingShape(f"{mode.f_hz:.4g} Hz, damping {100 * mode.zeta:.2g} %", moves.real, moves.imag))
    told = [f"{mode.f_hz:.4g} Hz, mostly {_mostly(plant, mode)}" for mode in modes]
    stands = "on the bench's sketch" if known else _in_a_row(len(plant.sensors))
    alike = "slowed and enlarged" + " alike" * (len(modes) > 1)
    caption = (
        f"The {_strongest(len(modes))} of the design plant from {limits_hz[0]:.3g} to "
        f"{limits_hz[1]:.4g} Hz, {stands}, {alike}: {'; '.join(told)}."
    )
    return Scene("modes", "Modes", caption, drawn.points, drawn.lines, shapes)


def _strongest(count: int) -> str:
    return f"{f'{count} ' if count > 1 else ''}strongest lightly damped {several_of(count, 'mode')}"


def _in_a_row(count: int) -> str:
    one, several = "its reading moving up and down", "in a row, each moving up and down"
    return one if count == 1 else f"{counted(count, 'reading')} {several}"


def _mostly(plant: StateSpace, mode: SeenMode) -> str:
    """Say which readings move most, those that move together before those that move against them."""
    size = np.abs(mode.shape)
    loud = [k for k in np.argsort(-size, kind="stable")[:3] if size[k] > 0.5 * size.max()]
    up = [bool(np.real(mode.shape[k]) > 0) for k in loud]
    named = [(plant.sensors[k].name, side == up[0]) for k, side in zip(loud, up, strict=True)]
    with_it, against = ([name for name, same in named if same is wanted] for wanted in (True, False))
    together = " together" if not against and len(with_it) > 1 else ""
    return " against ".join(" and ".join(side) for side in (with_it, against) if side) + together
