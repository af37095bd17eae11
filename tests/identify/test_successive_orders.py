"""Poles at one order after the other: those of the plant stand in line, in any units, and the diagram says so."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.identify.successive_orders import frequency_and_damping, poles_by_order
from ultraquiet.plot.pages.stabilisation import stabilisation
from ultraquiet.values import Record, StateSpace

RATE = 500.0
MODES = np.array([[20.0, 0.01], [55.0, 0.02], [130.0, 0.015]])


def plant(ny, nu, rng):
    """Three modes, each with a shape at the sensors and one at the actuators."""
    blocks, B, C = [], [], []
    for f, zeta in MODES:
        w = 2 * np.pi * f / RATE
        pole = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)))
        blocks.append(np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]))
        b, c = (x * np.sqrt(x.size) / np.linalg.norm(x) for x in (rng.standard_normal(nu), rng.standard_normal(ny)))
        B.append(np.vstack([b, np.zeros(nu)]))
        C.append(np.column_stack([np.zeros(ny), c]))
    A = np.zeros((6, 6))
    for k, block in enumerate(blocks):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
    return StateSpace(A, np.vstack(B), np.hstack(C), np.zeros((ny, nu)), rate_hz=RATE)


def record(ny, nu, scale, rng):
    u = rng.standard_normal((nu, 4000))
    y = plant(ny, nu, rng).simulate(u)
    return Record(u, scale * (y + 0.01 * y.std() * rng.standard_normal(y.shape)), RATE)


def in_the_plane(modes):
    """Frequency and damping as poles: one of the same frequency and far more damping is not near."""
    f, zeta = modes.T
    return f * (-zeta + 1j * np.sqrt(1 - zeta**2))


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_modes_of_the_plant_stand_in_line(ny, nu, scale, rng):
    roots = {n: frequency_and_damping(p, RATE) for n, p in poles_by_order(record(ny, nu, scale, rng), 20).items()}
    assert list(roots) == list(range(2, 21, 2))
    for n in (12, 16, 20):
        for f, zeta in MODES:
            near = roots[n][np.argmin(np.abs(in_the_plane(roots[n]) - in_the_plane(np.array([[f, zeta]]))))]
            assert near[0] == pytest.approx(f, rel=0.01)
            assert near[1] == pytest.approx(zeta, rel=0.5)
    chart = stabilisation(roots, (5.0, 250.0), 6)
    curves = {curve.name: curve for curve in chart.panels[0].curves}
    kept = np.asarray(curves["keeps frequency and damping"].x)
    assert all((np.abs(kept - f) < 0.01 * f).sum() >= 3 for f in MODES[:, 0])
    told = [float(word.split()[0]) for word in chart.caption.partition("damping: ")[2].split("%), ")]
    assert all(np.abs(np.array(told) / f - 1).min() < 0.01 for f in MODES[:, 0])


def test_nothing_that_moves_has_no_poles():
    with pytest.raises(InputError, match="no output"):
        poles_by_order(Record(np.ones((1, 100)), np.zeros((2, 100)), RATE))
    with pytest.raises(InputError, match="too few"):
        poles_by_order(Record(np.arange(8.0)[None], np.arange(8.0)[None] ** 2, RATE))


def test_a_diagram_without_a_mode_says_so():
    chart = stabilisation({2: np.array([[10.0, 0.1]]), 4: np.array([[20.0, 0.1]])}, (1.0, 100.0), None)
    assert "None stands still" in chart.caption
