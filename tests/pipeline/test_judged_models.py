"""What judges models is reused while nothing it depends on has changed, and made again when something did."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base.beside import Said
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.identification import sweep_groups
from ultraquiet.pipeline.making.models import ModelStages
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.study import IdentifyTable, parse

RATE_HZ = 400.0
PLAN = LoopPlan(("bench",), (), 1.0, 2.0, (10.0, 60.0))
STUDY = """
[study]
title = "one channel"
[records]
files = ["one.csv", "two.csv"]
[identify]
structures = ["arx"]
orders = [1]
records = "one"
held_out = "two"
[plant]
method = "subspace"
records = ["one"]
order = 2
[controllers.calm.design]
method = "lqg"
[paper]
structure = "arx"
order = 1
records = ["one"]
simulated = ["two"]
"""


def record(seed):
    """A mode of 30 Hz, newtons in, micrometres out."""
    w, rng = 2 * np.pi * 30.0 / RATE_HZ, np.random.default_rng(seed)
    u = rng.standard_normal((1, 800))
    y = lfilter([0.0, 3.0, 1.0], [1.0, -2 * 0.98 * np.cos(w), 0.98**2], u) + 1e-3 * rng.standard_normal((1, 800))
    return uq.Record(u, y, RATE_HZ, [uq.Channel("push", "N")], [uq.Channel("place", "um")])


def test_what_is_held_out_is_fitted_by_none():
    records = {"one": record(1), "two": record(2)}
    for held_out, groups in ((None, ("one", "two")), ("two", ("one", "two")), ("one", ("two", "one"))):
        assert sweep_groups(records, IdentifyTable(held_out=held_out)) == groups
    assert sweep_groups({"one": record(1)}, IdentifyTable(held_out="one")) == (None, "one")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('structure = "arx"\norder = 1', 'structure = "arx"\norder = 3'),
        ('structure = "arx"\norder = 1', 'structure = "output-error"\norder = 1'),
    ],
)
def test_another_structure_of_the_paper_is_judged_anew(old, new, tmp_path):
    records = {"one": record(1), "two": record(2)}

    def judged(text, folder):
        stages = ModelStages(parse(text), Cache(tmp_path / folder), None, records, lambda _: None)
        outcomes = stages.judged(stages.plant().values[stored.PLANT], PLAN, Said())
        (fit,) = outcomes[1].facts.records.values()
        return [outcome.reused for outcome in outcomes], dict(fit.fit_percent)

    first = judged(STUDY, "same")
    assert judged(STUDY, "same") == ([True] * 3, first[1])
    again, fresh = judged(STUDY.replace(old, new), "same"), judged(STUDY.replace(old, new), "fresh")
    print(first[1], again[1])
    assert again == fresh
    assert again[0] == [False] * 3
    assert again[1] != first[1]
