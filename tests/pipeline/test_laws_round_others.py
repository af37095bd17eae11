"""A law that a study puts round another: refused where that cannot be, made after it, and anew when it changes."""

import json

import numpy as np
import pytest
import small_study
from small_study import LIST

import ultraquiet as uq
from ultraquiet.pipeline import control
from ultraquiet.pipeline.making.designs import by_need, design_key
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.study import Design, StudyError, parse
from ultraquiet.testing.problems import damped_plant


@pytest.fixture
def known():
    with small_study.known():
        yield


PLAN = LoopPlan(("bench",), (), 1.0, 2.0, (10.0, 60.0))
HUM = """
[controllers.hum]
around = "calm"
[controllers.hum.design]
method = "resonators"
tones_hz = [40.0]
settling_s = 1.0
"""
ROUND_CALM = Design.model_validate({"around": "calm", "design": {"method": "resonators", "tones_hz": [40.0]}})


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('around = "calm"', 'around = "clam"', "there is no law 'clam' among the controllers calm, hum"),
        ('around = "calm"', 'around = "hum"', "'hum' is put round 'hum' in turn"),
        ('method = "resonators"\ntones_hz = [40.0]\nsettling_s = 1.0', 'method = "lqg"', "'lqg' is put round no other"),
        ("settling_s = 1.0", 'around = "lqg"', "the design's own 'around' says something else"),
    ],
)
def test_what_cannot_be_put_round_another_is_refused_with_its_line(before, after, words):
    text = small_study.STUDY + HUM.replace(before, after)
    with pytest.raises(StudyError) as refused:
        parse(text)
    ((line, sentence),) = refused.value.mistakes
    assert words in sentence
    assert text.splitlines()[line - 1].startswith("around")


@pytest.mark.usefixtures("known")
def test_laws_come_after_those_inside_them_whatever_their_order_and_whatever_is_asked():
    second = HUM.replace("controllers.hum", "controllers.more").replace('"calm"', '"hum"')
    for asked in ("", '\n[requirements]\nlaw = "more"\ndisk_margin = 0.1\n'):
        order = by_need(parse(second + HUM + small_study.STUDY + asked))
        assert order.index("calm") < order.index("hum") < order.index("more")
        assert sorted(order) == ["calm", "hum", "more"]
    with pytest.raises(StudyError, match="in turn"):
        parse(second + HUM.replace('"calm"', '"more"') + small_study.STUDY)


def test_the_law_inside_stays_in_the_sum_and_is_what_the_stage_depends_on(seed):
    plant = damped_plant(seed)
    inner = uq.design.Lqg().design(plant).controller
    made = control.designed("hum", plant, ROUND_CALM, PLAN, None, inner).values["hum"]
    f = np.array([12.0, 40.0, 200.0])
    own = uq.design.Resonators(tones_hz=(40.0,), around=inner).design(plant).controller
    assert np.array_equal(made.frequency_response(f), own.frequency_response(f))
    other = uq.StateSpace(inner.A, inner.B, 0.5 * inner.C, inner.D, inner.rate_hz)
    keys = [str(design_key(plant, ROUND_CALM, PLAN, {}, each)) for each in (inner, other, None)]
    assert len(set(keys)) == 3


def test_without_a_law_inside_there_is_none_outside(seed):
    outcome = control.designed("hum", damped_plant(seed), ROUND_CALM, PLAN)
    assert not outcome.values
    assert "'calm', round which it is to be put, has no law" in outcome.facts.status


@pytest.mark.slow
def test_a_study_makes_both_and_the_outer_one_anew_when_the_inner_one_changes(tmp_path):
    (tmp_path / "list.toml").write_text(LIST)
    study, folder, said = tmp_path / "study.toml", tmp_path / "out", []
    study.write_text(small_study.STUDY + HUM)
    small_study.walk(study, folder, say=said.append)
    calm, hum = (uq.files.load(folder / "controllers" / f"{name}.h5") for name in ("calm", "hum"))
    plant = uq.files.load(folder / "models" / "plant.h5")
    S = [
        np.linalg.norm(np.linalg.inv(np.eye(2) - (plant.frequency_response([40.0]) * 1)[:, :, 0] @ K), 2)
        for K in (each.frequency_response([40.0])[:, :, 0] for each in (calm, hum))
    ]
    print(f"at the tone S is {S[0]:.3g}, and {S[1]:.3g} with the bank round it")
    assert S[1] < 0.01 * S[0]
    written = (folder / "stages" / "design-hum.json").stat().st_mtime_ns
    small_study.walk(study, folder, say=said.append)
    assert (folder / "stages" / "design-hum.json").stat().st_mtime_ns == written
    study.write_text(study.read_text().replace("control_weight = 1e-2", "control_weight = 1e-1"))
    small_study.walk(study, folder, say=said.append)
    again = uq.files.load(folder / "controllers" / "hum.h5")
    assert again.hash != hum.hash
    assert json.loads((folder / "summary.json").read_text())["design"]["hum"]["method"] == "resonators"
