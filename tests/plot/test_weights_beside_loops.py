"""Weights drawn over the loops they made: same colour, dashed, and a caption that says which of them was met."""

import numpy as np

from ultraquiet.plot.pages.weights import EXCEEDED, WeightedFunction, weighted_loops

F_HZ = np.geomspace(1.0, 100.0, 41)


def drawn(*laws, member="S"):
    colours = {each.law: f"law-{k}" for k, each in enumerate(laws, 1)}
    return weighted_loops("weights", F_HZ, {member: laws}, colours, {"KS": "V/(m/s)"}, (5.0, 20.0))


def test_a_law_and_its_weight_have_one_colour_and_the_weight_is_dashed():
    chart = drawn(*(WeightedFunction(name, np.ones(41), np.full(41, 2.0)) for name in ("calm", "quiet")))
    curves = [(c.name, c.colour, c.dash) for c in chart.panels[0].curves]
    assert curves == [
        ("calm", "law-1", "-"),
        ("calm: left by its weight", "law-1", "--"),
        ("quiet", "law-2", "-"),
        ("quiet: left by its weight", "law-2", "--"),
    ]


def test_the_caption_says_where_a_loop_is_nearest_and_which_lies_above():
    values = np.ones(41)
    values[20] = 2.0
    under = WeightedFunction("calm", values, np.full(41, 2.0 * 10 ** (0.3 / 20)))
    over = WeightedFunction("quiet", values, np.full(41, 2.0 * 10 ** (-1.2 / 20)))
    assert "calm is nearest in S, 0.3 dB below at 10 Hz." in drawn(under).caption
    assert EXCEEDED not in drawn(under).caption
    both = drawn(under, over).caption
    assert "quiet is nearest in S, 1.2 dB above at 10 Hz." in both
    assert both.endswith(EXCEEDED)


def test_the_caption_says_which_laws_have_no_weight_and_why():
    under = WeightedFunction("shaped", np.ones(41), np.full(41, 2.0))
    methods = {"calm": "lqg", "slow": "skyhook", "still": "lqg", "late": "peak-bounded"}
    said = weighted_loops("w", F_HZ, {"S": [under]}, {"shaped": "law-1"}, {}, (5.0, 20.0), methods).caption
    assert "Of calm and still nothing is drawn: an LQG cost is a mean square over all frequencies" in said
    assert "Nothing in the design of slow and late weighs S, T or KS." in said
    assert "nothing is drawn" not in drawn(under).caption


def test_a_weight_far_above_takes_no_room_and_one_without_end_is_not_drawn():
    values = np.geomspace(0.1, 2.0, 41)
    far = drawn(WeightedFunction("calm", values, np.full(41, 1e8)), member="KS").panels[0]
    none = drawn(WeightedFunction("calm", values, np.full(41, np.inf)), member="KS").panels[0]
    near = drawn(WeightedFunction("calm", values, 10.0 * values), member="KS").panels[0]
    assert far.y.range == none.y.range
    assert far.y.range[1] < 20 * np.log10(2.0) + 4
    assert np.isnan(far.curves[1].y).all()
    assert near.y.range[1] >= 20 * np.log10(20.0)
    assert np.isfinite(near.curves[1].y).all()
    assert near.y.label == "|KS| (dB re V/(m/s))"
