"""Further units of a bench: recorded with the study's signals, identified likewise, given to designs that take them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from ultraquiet.bench import Hexapod
from ultraquiet.design import Lqg, PeakBounded
from ultraquiet.pipeline import identification as module
from ultraquiet.pipeline import packaged_study
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.further_units import further_plants
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.store.identity import identity
from ultraquiet.pipeline.walk import bench_key_of, bench_of, bench_table
from ultraquiet.values import StateSpace


def one():
    return StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)


def test_the_same_signals_go_to_the_other_unit_and_its_model_has_a_name_of_its_own(monkeypatch):
    bench, seen = Hexapod(unit="ground", linear=True), {}
    rng = np.random.default_rng(1)
    records = {f"low-{k}": bench.run(rng.standard_normal((6, 50))) for k in (1, 2)} | {
        "step": bench.run(np.ones((6, 50)))
    }

    def identified(again, settings):
        seen.update(again)
        return Outcome({stored.PLANT: one(), stored.RESPONSE: None}, SimpleNamespace(states=1))

    monkeypatch.setattr(module, "plant", identified)
    settings = packaged_study("suite").plant.model_copy(update={"records": ["low"]})
    outcome = module.further(Hexapod(unit="flight", linear=True), "flight", records, settings)
    assert list(seen) == ["low-1", "low-2"]
    assert list(outcome.values) == ["plant-flight"]
    for name, record in seen.items():
        np.testing.assert_array_equal(record.inputs, records[name].inputs)
        assert not np.array_equal(record.outputs, records[name].outputs)


def test_a_unit_made_by_itself_has_the_key_of_the_walk(tmp_path):
    """The walk's bench was written to its records' key and read again; here it is described afresh."""
    study, keys = packaged_study("suite"), []
    study = study.model_copy(update={"plant": study.plant.model_copy(update={"units": ["flight"]})})

    class Noted:
        def stage(self, name, folder, key, facts, compute):
            keys.append(key)
            return Outcome({"plant-flight": one()}, SimpleNamespace())

    further_plants(study, {}, tmp_path, Noted())
    described = identity(bench_of(study, tmp_path), bench_table(study), tmp_path)
    written = json.loads(json.dumps(to_plain(described)))
    assert keys[0][-2:] == [bench_key_of(study, written), "flight"]
    blended = study.model_copy(update={"blending": "a table"})
    assert bench_key_of(blended, written) == bench_key_of(blended, described) == [written, "a table"]


@pytest.mark.parametrize(("method", "given"), [(PeakBounded(), 2), (Lqg(), 1)])
def test_only_designs_that_hold_on_several_plants_are_given_them(method, given):
    others = {"flight": Outcome({"plant-flight": one()}, SimpleNamespace())}
    plants = module.for_method(method, one(), others)
    assert (len(plants) if isinstance(plants, list) else 1) == given
