"""The C31 count against the figures it must keep, and what a refusal says."""

import pytest

from ultraquiet.deploy import generate, kernel_cycles, largest_order
from ultraquiet.deploy.c31.cycles import BUDGET_CYCLES, SKELETON_CYCLES

# Instructions six by six, of hand-written kernels and of the emitted ones alike: form, anti-windup, at 60 states,
# at 120, largest order in 2800.
KERNELS = [
    ("dense", False, 5016, 17136, 40),
    ("modal", False, 1001, 1901, 170),
    ("delta", False, 1061, 2021, 158),
    ("modal", True, 1361, 2621, 120),
]


@pytest.mark.parametrize(("form", "anti_windup", "at_60", "at_120", "largest"), KERNELS)
def test_model_counts_what_the_kernels_take(form, anti_windup, at_60, at_120, largest):
    assert kernel_cycles(form, 60, anti_windup=anti_windup) == at_60
    assert kernel_cycles(form, 120, anti_windup=anti_windup) == at_120
    assert largest_order(form, anti_windup=anti_windup) == largest


@pytest.mark.parametrize("form", ["dense", "modal", "delta", "schur"])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_largest_order_fits_and_the_next_does_not(form, anti_windup):
    n = largest_order(form, anti_windup=anti_windup)
    step = 2 if form in ("modal", "delta") else 1
    assert SKELETON_CYCLES + kernel_cycles(form, n, anti_windup=anti_windup) <= BUDGET_CYCLES
    assert SKELETON_CYCLES + kernel_cycles(form, n + step, anti_windup=anti_windup) > BUDGET_CYCLES


def test_tables_count_frame_and_kernel(law_of, tmp_path):
    tables = generate(law_of(60), tmp_path / "code", form="modal").tables
    print({k: v for k, v in tables.items() if k.startswith("c31")})
    assert tables["c31_kernel_cycles"] == 1001
    assert tables["c31_cycles"] == 1001 + 142
    assert tables["c31_budget"] == 2800
    assert tables["c31_fits_the_model"] is True


def test_law_beyond_the_budget_is_generated_but_not_said_to_fit(law_of, tmp_path):
    made = generate(law_of(180), tmp_path / "code", form="modal")
    assert made.tables["c31_fits_the_model"] is False
    assert made.tables["c31_largest_order"] == 170


def test_refusal_names_the_largest_order_that_fits(law_of, tmp_path):
    with pytest.raises(ValueError, match=r"180 states in modal form need 2943 of 2800 .* fit is 170 in this form"):
        generate(law_of(180), tmp_path / "code", form="modal", enforce_budget=True)
    assert not (tmp_path / "code").exists()


@pytest.mark.gate("True-120")
@pytest.mark.parametrize(("anti_windup", "largest"), [(False, 170), (True, 120)])
def test_unreduced_laws_fit_up_to_the_largest_order_and_not_beyond(anti_windup, largest, law_of, tmp_path):
    settings = {"form": "modal", "anti_windup": anti_windup, "budget_share": 1.0}
    made = generate(law_of(largest), tmp_path / "fits", **settings)
    print(f"{largest} states: {made.tables['c31_cycles']} of 2800, {made.tables['c31_words']} words")
    assert made.tables["c31_cycles"] <= 2800
    with pytest.raises(ValueError, match=f"largest order that would fit is {largest} in this form"):
        generate(law_of(largest + 2), tmp_path / "beyond", **settings)
    assert not (tmp_path / "beyond").exists()


def test_share_of_the_budget_is_refused_above_and_kept_below(law_of, tmp_path):
    with pytest.raises(
        ValueError, match=r"78 states .* need 1413 of 1400 \(50 % of 2800\) .* would fit is 76 in this form"
    ):
        generate(law_of(78), tmp_path / "code", form="modal", budget_share=0.5)
    assert not (tmp_path / "code").exists()
    made = generate(law_of(76), tmp_path / "code", form="modal", budget_share=0.5)
    print(f"76 states: {100 * made.tables['c31_budget_share']:.1f} % of the budget")
    assert made.tables["c31_budget_share"] <= 0.5


def test_impossible_budget_is_refused(law_of, tmp_path):
    with pytest.raises(ValueError, match="largest order that would fit is 0"):
        generate(law_of(2), tmp_path / "code", form="modal", enforce_budget=True, budget_cycles=150)
