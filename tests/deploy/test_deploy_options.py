"""What `generate` may be asked for: objects or single settings, the same code."""

import inspect

import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import C31Budget, CodeOptions, FixedOptions, generate, generate_fixed

SETTINGS = {
    "form": "modal",
    "anti_windup": "auto",
    "disturbance_v": None,
    "excitation_v": None,
    "overrun_limit": 4,
    "ramp_s": 0.1,
    "tolerance": 1e-2,
    "targets": ("c99", "c31"),
    "budget_cycles": 2800,
    "enforce_budget": True,
    "budget_share": 1.0,
    "plant": None,
}


def texts(made):
    return {path.name: path.read_text() for path in made.folder.iterdir()}


def test_options_and_single_settings_make_the_same_code(law_of, tmp_path):
    law = law_of(6)
    code = {"form": "delta", "anti_windup": True, "excitation_v": 1.0, "overrun_limit": 6, "ramp_s": 0.02}
    one = generate(law, tmp_path / "one", **code, budget_cycles=2000, budget_share=0.9)
    options, c31 = CodeOptions(**code), C31Budget(cycles=2000, share=0.9)
    other = generate(law, tmp_path / "other", options=options, c31=c31)
    assert texts(one) == texts(other)
    assert one.tables["c31_budget"] == 2000


@pytest.mark.slow
def test_every_setting_of_old_is_taken(law_of, tmp_path):
    made = generate(law_of(4), tmp_path / "code", limits_v=25.0, **SETTINGS)
    assert made.tables["form"] == "modal"
    assert "controller_c31.asm" in texts(made)


@pytest.mark.parametrize("call", [generate, generate_fixed])
def test_no_more_than_ten_parameters(call):
    assert len(inspect.signature(call).parameters) <= 10


def test_whole_numbers_take_options_or_single_settings_too(law_of, tmp_path):
    law = law_of(4)
    settings = {"form": "delta", "scaling": "l2", "input_v": 9.0, "output_v": 20.0, "ramp_s": 0.01, "tolerance": 1.0}
    one = generate_fixed(law, tmp_path / "one", "q15", plant=None, **settings)
    other = generate_fixed(law, tmp_path / "other", "q15", options=FixedOptions(**settings))
    assert texts(one) == texts(other)
    with pytest.raises(InputError, match="generate_fixed: there is no setting 'ramp'; there are form, scaling"):
        generate_fixed(law, tmp_path / "none", ramp=1.0)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"shape": "modal"}, "there is no setting 'shape'; there are form, anti_windup"),
        ({"ramp": 1.0, "budget": 3}, "there is no setting 'budget', 'ramp'"),
        ({"options": CodeOptions(), "form": "modal"}, r"give 'options' or single settings \(form\), not both"),
        ({"c31": C31Budget(), "enforce_budget": True}, r"give 'c31' or single settings \(enforce_budget\), not both"),
        ({"options": C31Budget()}, "'options' must be CodeOptions, got C31Budget"),
        ({"c31": 2800}, "'c31' must be C31Budget, got int"),
    ],
)
def test_a_setting_that_is_none_is_refused_in_a_sentence(law_of, tmp_path, settings, sentence):
    with pytest.raises(InputError, match=sentence):
        generate(law_of(2), tmp_path / "code", **settings)
    assert not (tmp_path / "code").exists()


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: CodeOptions(form="companion"), "'form' must be one of 'auto', 'modal'"),
        (lambda: CodeOptions(anti_windup="yes"), "'anti_windup' must be"),
        (lambda: CodeOptions(overrun_limit=0), "'overrun_limit' must be"),
        (lambda: CodeOptions(ramp_s=0.0), "'ramp_s' must be"),
        (lambda: CodeOptions(tolerance=2.0), "'tolerance' must lie between"),
        (lambda: CodeOptions(targets=("c31",)), "'targets' must list 'c99'"),
        (lambda: C31Budget(cycles=0), "'budget_cycles' must be at least 1"),
        (lambda: C31Budget(share=1.5), "'budget_share' must lie between"),
    ],
)
def test_options_are_checked_where_they_are_made(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


@pytest.mark.parametrize("rate_hz", [0.01, 0.9, 1.0, 2.9])
def test_a_ramp_that_nobody_chose_has_a_sample_at_least(rate_hz):
    assert CodeOptions().ramp_steps(rate_hz) == 1
    with pytest.raises(InputError, match="'ramp_s in samples' must be between 1 and"):
        CodeOptions(ramp_s=0.4 / rate_hz).ramp_steps(rate_hz)


def test_a_law_of_a_sample_a_second_becomes_code(law_of, tmp_path):
    law = law_of(4)
    slow = type(law)(law.A, law.B, law.C, law.D, rate_hz=1.0)
    assert generate(slow, tmp_path / "code").law.ramp_steps == 1
