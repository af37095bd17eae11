"""What is required of a loop is seen in its figure, however far the laws are from it."""

import numpy as np
import pytest

from ultraquiet.plot.pages.loops import LoopCurve, RequiredOfLoop, measured_loops, shaped_loops

F_HZ = np.geomspace(1.0, 100.0, 50)
ASKED = RequiredOfLoop((5.0, 50.0), attenuation_db=20.0, peak_db=6.0)


@pytest.mark.parametrize("level_db", [14.0, -30.0])
def test_the_region_that_is_asked_for_is_within_the_axes(level_db):
    size = np.full(F_HZ.size, 10 ** (level_db / 20))
    shaped = shaped_loops("loops", F_HZ, {"S": {"law": size}, "T": {"law": size}}, {"law": "law-1"}, {}, ASKED)
    low, high = shaped.panels[0].y.range
    assert low <= -26.0
    assert high >= max(level_db, 6.0)
    assert shaped.panels[1].y.range[0] == pytest.approx(level_db - 3.0)  # T is asked nothing
    measured = measured_loops("bench", [LoopCurve("law", F_HZ, np.full(50, level_db), "law-1")], ASKED)
    found = measured.panels[0].y.range
    print(f"{level_db:g} dB: {low:g} to {high:g} dB on the model, {found} on the bench")
    assert (found is None) is (level_db == -30.0)
    assert found is None or (found[0] <= -26.0 and found[1] >= 20.0)


def test_without_a_requirement_the_axes_fit_the_curves():
    measured = measured_loops("bench", [LoopCurve("law", F_HZ, np.zeros(50), "law-1")], RequiredOfLoop((5.0, 50.0)))
    assert measured.panels[0].y.range is None


def test_a_picture_of_the_bench_says_over_which_frequencies_it_was_heard():
    heard = measured_loops("bench", [LoopCurve("law", F_HZ, np.zeros(50), "law-1")], ASKED)
    assert f"on the bench from {F_HZ[0]:.3g} to {F_HZ[-1]:.4g} Hz, where it was heard" in heard.caption
