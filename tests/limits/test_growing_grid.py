"""The programme on a growing grid beside the one that has every point at once."""

from dataclasses import replace

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.limits.demands import Wishes
from ultraquiet.limits.loops import stabilised
from ultraquiet.limits.programme import VIOLATED, solve, solve_on
from ultraquiet.limits.search import LimitSearch
from ultraquiet.testing import problems


@pytest.fixture(scope="module")
def programme():
    """Functions and demands of a lightly damped scalar plant."""
    plant = problems.damped_plant(1)
    one = uq.StateSpace(plant.A, plant.B[:, :1], plant.C[:1], plant.D[:1, :1], plant.rate_hz)
    low = 0.01 * one.rate_hz
    search = LimitSearch(stabilised(one), (low, 5 * low), 30)
    wishes = Wishes((low, 5 * low), 2.0, 50.0 / float(np.abs(search.lines.b[search.inside]).max()))
    functions = wishes.control_gain * search.basis.at(search.circle.angles(search.f_hz))
    some = slice(None, None, 4)
    demands = [
        replace(d, a=d.a[some], b=d.b[some], limit=d.limit[some]) for d in wishes.demands(search.f_hz, search.lines)
    ]
    return functions[:, some], demands


def test_points_left_out_change_nothing(programme):
    functions, demands = programme
    grown, whole = solve(functions, demands), solve_on(functions, demands, [np.isfinite(d.limit) for d in demands])
    put = sum(int(on.sum()) for on in grown.active)
    every = sum(int(np.isfinite(d.limit).sum()) for d in demands)
    print(f"level {grown.level:.6f} with {put} of {every} points, {whole.level:.6f} with all, {grown.rounds} rounds")
    assert whole.ok
    assert grown.ok
    assert grown.rounds > 1
    assert put < every
    assert grown.level == pytest.approx(whole.level, rel=1e-3)
    for demand in demands:
        share = demand.reached(grown.weights @ functions, grown.level) / (1.0 if demand.sought else demand.tight)
        assert share.max() <= VIOLATED + 1e-6, demand.name


def test_a_solution_is_gone_on_from(programme):
    functions, demands = programme
    first = solve(functions, demands)
    again = solve(functions, demands, start=first)
    assert again.ok
    assert again.rounds <= 2
    assert again.level == pytest.approx(first.level, rel=1e-5)
    assert all(np.all(later[before]) for before, later in zip(first.active, again.active, strict=True))
