"""The peak of S that a figure names is that of the loop, not of the grid it is drawn on."""

from types import SimpleNamespace

import numpy as np
from scipy.linalg import expm

from ultraquiet.analyse import peak_sensitivity
from ultraquiet.analyse.peaks import refined
from ultraquiet.design import Resonators
from ultraquiet.pipeline.report import laws as report_laws
from ultraquiet.pipeline.report.laws import _largest, _responses
from ultraquiet.values import StateSpace


def ringing():
    """Return a study of a mode and a law with a tone on it, as far as its figures ask."""
    w = 2 * np.pi * 43.0
    M = expm(np.array([[0.0, w, 0.0], [-w, -0.02 * w, 1.0], [0.0, 0.0, 0.0]]) / 2000.0)
    plant = StateSpace(M[:2, :2], M[:2, 2:], [[1.0, 0.0]], [[0.0]], 2000.0)
    law = Resonators(tones_hz=(43.0,)).design(plant).controller
    facts = SimpleNamespace(f_hz=np.geomspace(1.0, 900.0, 60))
    return SimpleNamespace(analysis=SimpleNamespace(facts=facts), design_plant=plant, laws={"law": law})


def test_the_peak_is_sought_once_for_all_figures(monkeypatch):
    sought = []
    monkeypatch.setattr(report_laws, "refined", lambda *args: sought.append(1) or refined(*args))
    result = ringing()
    report_laws._over_frequency.cache_clear()
    first, again = _responses(result), _responses(result)
    assert len(sought) == 1
    assert first is again
    assert not first[1].flags.writeable
    other = SimpleNamespace(**vars(result) | {"laws": {"other": result.laws["law"]}})
    assert set(_responses(other)[2]) == {"other"}


def test_a_narrow_peak_between_the_lines_is_drawn_as_high_as_it_is():
    result = ringing()
    plant, law, facts = result.design_plant, result.laws["law"], result.analysis.facts
    f, G, laws = _responses(result)
    S = _largest(G, laws["law"], ("S",))["S"]
    peak_db, at_hz = peak_sensitivity(plant, law)
    assert abs(20 * np.log10(S.max()) - peak_db) < 0.01
    assert abs(f[S.argmax()] - at_hz) < 0.01 * at_hz
    assert set(facts.f_hz) <= set(f)
