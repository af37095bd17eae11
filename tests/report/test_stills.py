"""Stills drawn by two processes are those that one draws, in their order; a process that fails costs its time alone."""

import numpy as np
import pytest

from ultraquiet.plot import Figure
from ultraquiet.plot.figure import Line, Panel
from ultraquiet.report import stills


@pytest.fixture
def figures():
    x = np.linspace(0.0, 1.0, 50)
    return [Figure(f"n{k}", f"Number {k}", "", [Panel([Line(x, x**k, f"power {k}")])]) for k in range(1, 6)]


@pytest.fixture
def alone(figures, monkeypatch):
    monkeypatch.setattr(stills.os, "cpu_count", lambda: 1)
    return stills.stills(figures)


def test_two_processes_draw_what_one_draws(figures, alone, monkeypatch):
    monkeypatch.setattr(stills.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(stills, "MANY", 2)
    own = []
    draw = stills.draw_small_png
    monkeypatch.setattr(stills, "draw_small_png", lambda figure, most: own.append(figure.name) or draw(figure, most))
    assert stills.stills(figures) == alone
    assert own == ["n1", "n2", "n3"]
    assert len(set(alone)) == len(figures)


def test_what_the_other_process_does_not_draw_is_drawn_here(figures, alone, monkeypatch):
    monkeypatch.setattr(stills.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(stills, "MANY", 2)
    monkeypatch.setattr(stills.sys, "executable", "false")
    assert stills.stills(figures) == alone
