"""What a study keeps of a law's margins: both ends, channels named, of the law that runs."""

from types import SimpleNamespace

import numpy as np

from ultraquiet.pipeline.control import designed
from ultraquiet.pipeline.facts.typed import finite, to_plain
from ultraquiet.pipeline.report.loops import margins_table
from ultraquiet.pipeline.study import ClosedLoop, Design
from ultraquiet.values import StateSpace

RATE = 2000.0
LOOP = ClosedLoop(band_hz=(1.0, 10.0), tones_hz=[3.0])
PLANT = StateSpace(
    np.kron(np.eye(2), [[0.98, 0.19], [-0.19, 0.98]]),
    np.kron(np.eye(2), [[0.1], [0.0]]),
    np.kron([[1.0, 0.5], [0.5, 1.0]], [[1.0, 0.3]]),
    np.zeros((2, 2)),
    RATE,
    actuators=["left", "right"],
    sensors=["top", "side"],
)


def test_margins_of_the_law_that_runs_stand_in_facts_and_report():
    plain = designed("plain", PLANT, Design.model_validate({"design": {"method": "lqg"}}), LOOP)
    reduce = {"method": "closed-loop-weighted", "states": 3}
    small = designed("small", PLANT, Design.model_validate({"design": {"method": "lqg"}, "reduce": reduce}), LOOP)
    assert set(plain.facts.law_margins) == {"input", "output"}
    assert plain.facts.law_margins["input"].disk_all == plain.facts.margins["input"].disk_all
    assert plain.facts.law_margins["input"].least_change.channel in {"left", "right"}
    assert plain.facts.law_margins["output"].least_change.channel in {"top", "side"}
    assert small.facts.margins["input"].disk_all == plain.facts.margins["input"].disk_all
    assert small.facts.law_margins["input"].disk_all != small.facts.margins["input"].disk_all
    assert finite(to_plain(small.facts))["law_margins"]["output"]["least_change"]["kind"] in {"gain", "phase"}
    rows = margins_table(SimpleNamespace(designs={"plain": plain, "small": small})).rows
    assert [row[:2] for row in rows] == [(n, side) for n in ("plain", "small") for side in plain.facts.law_margins]
    assert any(wire in str(rows[0][-1]) + str(rows[1][-1]) for wire in ("left", "right"))
