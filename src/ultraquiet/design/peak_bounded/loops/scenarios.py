"""Plants near a plant: gains of channels and frequencies of modes moved by a few per cent, drawn from a seed."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.law_structure.plane import Plane, plane_of
from ultraquiet.linalg import balance
from ultraquiet.linalg.even import UNEVEN, evened
from ultraquiet.values.interconnect import series
from ultraquiet.values.state_space import StateSpace

KNOT = 1.5  # frequencies of modes move independently when further apart than about this factor
BESIDE = 4.0
CEILING = 0.98  # of Nyquist: modes are not moved beyond it


def perturbed(
    plant: StateSpace,
    draws: int,
    gain_spread: float,
    mode_spread: float,
    rng: np.random.Generator,
    band_hz: tuple[float, float],
) -> list[StateSpace]:
    """Return plants drawn near one: G' = (1 + g) diag(1 + a) G(f / (1 + m(f))) diag(1 + b).

    Args:
        plant: G.
        draws: how many.
        gain_spread: share by which a channel may be off: half of it at either end, b in gain and a = e (s - p) /
            (s + p) in gain and phase, of one size at all frequencies, as the corners of filters, amplifiers and sensors
            move both; g of all together is a quarter of it, up and down in turn.
        mode_spread: share by which frequencies of oscillating modes move, a function of frequency that is drawn at
            knots a factor 1.5 apart: modes that lie close to one another move together, so that the small differences
            between them that an identified model relies on are kept.
        rng: draws.
        band_hz: p is drawn in it and a factor of four beside.

    Poles are moved with their residues scaled such that every mode keeps its own gain at zero frequency. Real poles,
    delays and modes that cannot be told apart stay.
    """
    out: list[StateSpace] = []
    ny, nu = plant.D.shape
    for k in range(draws):
        common = 1 + (-1.0) ** k * gain_spread / 4
        rows, columns = (gain_spread / 2 * _towards_the_edge(n, rng) for n in (ny, nu))
        corners = np.exp(rng.uniform(np.log(band_hz[0] / BESIDE), np.log(band_hz[1] * BESIDE), ny))
        moved = _moved(plant, rng.uniform(-1, 1, 64) * mode_spread)
        inputs = common * (1 + columns)
        moved = StateSpace(moved.A, moved.B * inputs, moved.C, moved.D * inputs, plant.rate_hz)
        out.append(series(moved, _off(rows, corners, plane_of(plant))) if gain_spread > 0 else moved)
    return out


def _towards_the_edge(n: int, rng: np.random.Generator) -> FloatArray:
    """Return numbers of either sign between a half and one: of many channels some are always near their limits."""
    return rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.0, n)


def _off(e: FloatArray, corners_hz: FloatArray, plane: Plane) -> StateSpace:
    """Return diag(1 + e (s - p) / (s + p))."""
    p = plane.of_hz(corners_hz)
    root = np.sqrt(2 * p)
    return plane.from_plane((np.diag(-p), np.diag(root), np.diag(-e * root), np.diag(1 + e)))


def _moved(plant: StateSpace, knots: FloatArray) -> StateSpace:
    """Return the plant with its oscillating modes moved by a function of the logarithm of their frequency."""
    if not plant.states:
        return plant
    form = balance.modal(*evened(plant.A, plant.B, plant.C, UNEVEN))
    A, B = form.A.copy(), form.B.copy()
    at = 0
    for size in form.blocks:
        here = slice(at, at + size)
        at += size
        block = form.A[here, here]
        if size != 2 or block[0, 1] * block[1, 0] >= 0:
            continue
        values = np.linalg.eigvals(block).astype(np.complex128)
        if values[0].imag == 0:  # delays, of which rounding made a pair
            continue
        new = _elsewhere(values, knots, plant.rate_hz)
        # a real function of the block that has these eigenvalues: block' = x + y block
        y = (new[0] - new[1]) / (values[0] - values[1])
        x = new[0] - y * values[0]
        A[here, here] = x.real * np.eye(2) + y.real * block
        still = np.eye(2) if plant.rate_hz is not None else np.zeros((2, 2))
        # c (z - A)^-1 b at zero frequency stays what it was
        B[here] = (still - A[here, here]) @ np.linalg.solve(still - block, form.B[here])
    return StateSpace(A, B, form.C, plant.D, plant.rate_hz)


def _elsewhere(values: ComplexArray, knots: FloatArray, rate_hz: float | None) -> ComplexArray:
    """Return a pair of eigenvalues with its frequency and its width moved by the same share."""
    s = values if rate_hz is None else np.log(values)
    size = abs(s[0]) if rate_hz is None else abs(s[0]) / np.pi
    place = np.log(size) / np.log(KNOT) % (knots.size - 1)
    low = int(place)
    share = 1 + knots[low] + (place - low) * (knots[low + 1] - knots[low])
    if rate_hz is not None:
        share = min(share, max(1.0, CEILING * np.pi / abs(s[0].imag)))
    moved = share * s
    return moved if rate_hz is None else np.exp(moved)
