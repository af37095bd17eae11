"""Laws side by side: what captions tell of many of them, what has no place in a panel, what is asked where."""

import numpy as np

from ultraquiet.plot.pages.loops import LoopCurve, RequiredOfLoop, loci, measured_loops, shaped_loops

F_HZ = np.geomspace(1.0, 100.0, 40)
ASKED = RequiredOfLoop((5.0, 20.0), 10.0, 6.0)


def curves(n):
    return [LoopCurve(f"law {k}", F_HZ, np.full(40, -k - 1.0), "chosen" if k == 1 else "law-1") for k in range(n)]


def test_of_many_loops_the_caption_tells_those_of_the_chosen_law():
    few, many = (measured_loops("s", curves(n), ASKED).caption for n in (4, 5))
    assert [f"law {k}:" in few for k in range(4)] == [True] * 4
    assert [f"law {k}:" in many for k in range(5)] == [False, True, False, False, False]


def test_a_law_that_does_nothing_takes_no_room_from_the_others():
    strong, none = np.geomspace(0.1, 2.0, 40), np.full(40, 1e-9)
    laws = {"strong": strong, "none": none}
    members = {"S": {"strong": strong, "none": np.ones(40)}, "T": laws, "KS": laws}
    chart = shaped_loops("l", F_HZ, members, {"strong": "chosen", "none": "law-1"}, {}, ASKED)
    for panel in chart.panels[1:]:
        assert panel.y.range[0] > 20 * np.log10(strong.min()) - 4
    assert "none lies below what is drawn of T and KS." in chart.caption
    assert "strong lies below" not in chart.caption


def test_the_colour_of_a_requirement_stands_where_something_is_required():
    members = {name: {"law": np.ones(40)} for name in ("S", "T", "KS")}
    for asked, colour in ((ASKED, "requirement"), (RequiredOfLoop((5.0, 20.0)), "muted")):
        of_s, *others = (
            panel.regions[0].colour for panel in shaped_loops("l", F_HZ, members, {"law": "chosen"}, {}, asked).panels
        )
        assert of_s == colour
        assert others == ["muted", "muted"]


def test_loci_pass_the_critical_point_as_near_as_the_caption_says():
    loop = np.zeros((2, 2, 3), dtype=complex)
    loop[0, 0], loop[1, 1] = [0.5, 0.2, 0.1], [0.1j, 0.2j, 0.3j]
    chart = loci("law", loop)
    near = min(np.abs(1 - loop[k, k]).min() for k in range(2))
    assert f"passes -1 at {near:.2f}." in chart.caption
    assert [curve.name for curve in chart.panels[0].curves] == ["locus 1", "locus 2", "critical point"]
