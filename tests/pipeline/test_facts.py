"""Facts are typed, one way to JSON and back; the summary, its schema in the documentation and its readers agree."""

import json
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ultraquiet as uq
from ultraquiet.pipeline.facts.code import CodeFacts, DeploymentFacts, NoCode, WholeNumberFacts
from ultraquiet.pipeline.facts.limits import BandLimit, LimitFacts, RefusedBand
from ultraquiet.pipeline.facts.loops import LoopFacts, StableLoop, UnstableLoop
from ultraquiet.pipeline.facts.models import PlantFacts, RecordFit, RecordPlant, ResponsePlant, Root, SingularValues
from ultraquiet.pipeline.facts.typed import finite, from_plain, to_plain
from ultraquiet.pipeline.making.code import generated
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.summary import schema_text

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "docs" / "summary.schema.json"
# Left by `ultraquiet demo --quick` of version 0.1.0, before facts were typed.
OLD_SUMMARY = ROOT / "tests" / "data" / "studies" / "summary.json"
REGENERATE = (
    "regenerate it: python -c \"from ultraquiet.pipeline.summary import schema_text; print(schema_text(), end='')\" "
    "> docs/summary.schema.json"
)


def returned(kind, facts):
    """Facts as a stage's file gives them back."""
    return from_plain(kind, json.loads(json.dumps(to_plain(facts))))


@given(st.lists(st.floats(), max_size=4), st.integers(0, 300))
def test_arrays_and_every_float_come_back_as_they_were(numbers, states):
    facts = RecordPlant(status="ok", fit_percent=np.array(numbers), states=states)
    again = returned(PlantFacts, facts)
    assert type(again) is RecordPlant
    assert again.states == states
    np.testing.assert_array_equal(again.fit_percent, facts.fit_percent)


def test_each_of_a_union_comes_back_as_itself():
    response = ResponsePlant(status="ok", states=4, order=2, held_out_error=0.1, errors_by_order={2: 0.1, 4: np.nan})
    again = returned(PlantFacts, response)
    assert type(again) is ResponsePlant
    assert list(again.errors_by_order) == [2, 4]
    loops = LoopFacts(units={"flight": UnstableLoop(status="unstable: It ran away.")})
    assert type(returned(LoopFacts, loops).units["flight"]) is UnstableLoop
    refused = RefusedBand(band_hz=(5.0, 100.0), peak_db=6.0, control_gain=1e3, status="refused: no")
    bounded = BandLimit(**vars(refused) | {"attenuation_db": 1.0, "bound_db": 2.0, "binding": {"peak": ((1.0, 2.0),)}})
    again = returned(LimitFacts, LimitFacts(bands=(bounded, refused), designs={}))
    assert [type(band) for band in again.bands] == [BandLimit, RefusedBand]
    assert again.bands[0].binding["peak"] == ((1.0, 2.0),)
    assert type(returned(DeploymentFacts, NoCode(status="refused: no"))) is NoCode


def test_facts_are_frozen_and_checked_when_they_are_made():
    root = {"frequency_hz": 1.0, "zeta": 0.1, "outside": False, "real": 0.9, "imag": 0.1}
    with pytest.raises(FrozenInstanceError):
        Root(**root).zeta = 0.2
    for wrong in ({"zeta": "much"}, {"outside": None}, {"colour": "red"}):
        with pytest.raises((ValueError, TypeError)):
            Root(**root | wrong)
    with pytest.raises(ValueError, match="2 dimensions"):
        SingularValues(plant=np.zeros(3), paper=np.zeros((3, 2)))
    gains = SingularValues(plant=np.zeros((3, 2)), paper=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="read-only"):
        gains.plant[0, 0] = 1.0


def test_a_stage_file_of_another_shape_is_computed_again(tmp_path):
    computed = []

    def compute():
        computed.append(1)
        return Outcome({}, RecordFit(channel=1, fit_percent={"plant": 90.0}, clipped_samples=0))

    def stage():
        return Cache(tmp_path).stage("fit", "models", "key", compute, RecordFit).facts

    assert stage().fit_percent == stage().fit_percent == {"plant": 90.0}
    assert len(computed) == 1
    path = tmp_path / "stages" / "fit.json"
    for change in ({"channel": "first"}, {"colour": "red"}):
        content = json.loads(path.read_text())
        content["facts"] |= change
        path.write_text(json.dumps(content))
        assert stage().channel == 1
    assert len(computed) == 3


def test_the_schema_in_the_documentation_is_that_of_the_code():
    assert SCHEMA.read_text() == schema_text(), REGENERATE


def test_a_summary_of_the_version_before_meets_the_schema_and_a_wrong_one_does_not():
    schema, summary = (json.loads(path.read_text()) for path in (SCHEMA, OLD_SUMMARY))
    jsonschema.validate(summary, schema)
    ground = summary["closed_loop"]["hinf-band"]["ground"]
    ground["peak_amplification"] = ground.pop("peak_amplification_db")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(summary, schema)


def test_what_is_no_finite_number_is_null_in_a_summary_and_allowed_by_its_schema():
    measured = dict.fromkeys((f.name for f in fields(StableLoop)), np.nan)
    known = {"stable": True, "status": "ok", "tones": {}, "band_hz": (10.0, np.inf), "heard_hz": (np.nan, 3.0)}
    loop = StableLoop(**measured | known | {"lines": 3, "lines_missing": 0, "lines_hidden": None})
    plain = finite(to_plain(loop))
    assert plain["band_hz"] == [10.0, None]
    assert plain["peak_amplification_db"] is None
    schema = json.loads(SCHEMA.read_text())
    jsonschema.validate(plain, {"$ref": "#/$defs/StableLoop", "$defs": schema["$defs"]})


def test_every_key_of_a_deployment_is_a_fact(tmp_path):
    law = uq.StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    code = uq.deploy.generate(law, tmp_path / "code", limits_v=10.0)
    assert set(code.tables) <= {f.name for f in fields(CodeFacts)}
    facts = generated(code, "not verified")
    assert facts.bit_exact is None
    assert facts.states == 2
    whole = uq.deploy.generate_fixed(law, tmp_path / "whole", input_v=3.0, output_v=[[-4.0, 2.0]])
    assert set(whole.tables) <= {f.name for f in fields(WholeNumberFacts)}
    found = generated(whole, "not verified")
    assert (found.measurements, found.commands) == (("input 1 -3 to 3",), ("output 1 -2 to 2",))
