"""What a page says beside what it does: of a law that a hand replaces, of fields and refusals, of what is not there."""

import shutil

import pytest
from workbench_helpers import browser, finished_study, served

from ultraquiet.workbench import Session

pytestmark = [pytest.mark.web, pytest.mark.slow]
OVER = """([one, other]) => {
  const [a, b] = [one, other].map((s) => document.querySelector(s).getBoundingClientRect());
  return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A study of one input and one output with a law."""
    return finished_study(tmp_path_factory.mktemp("one") / "one", 1, 1)


@pytest.fixture
def study(finished, tmp_path):
    """A copy of it to change."""
    return shutil.copytree(finished, tmp_path / "study")


def test_a_weight_drawn_by_hand_says_what_it_replaced_and_undo_brings_it_back(study):
    with served(study) as made, browser(made) as seen:
        seen.go("design")
        seen.drawn("loop-chart")
        seen.fill("law-name", "quiet")
        handle = "[data-testid='slide-band-low']"
        seen.page.locator(f"{handle} [tabindex]").or_(seen.page.locator(f"{handle}[tabindex]")).first.press(
            "ArrowRight"
        )
        said = seen.page.locator(".q-notification").filter(has_text="quiet was made anew with the weight you drew")
        said.wait_for()
        print(said.inner_text())
        assert "undo (Ctrl+Z) brings back the one before" in said.inner_text()
        assert Session(study).state["laws"]["quiet"]["method"]["method"] == "mixed-sensitivity"
        seen.page.locator("header .uq-brand").click()  # no field has the keys
        seen.page.keyboard.press("Control+z")
        seen.page.get_by_test_id("laws-0").filter(has_text="lqg").wait_for()
        assert Session(study).state["laws"]["quiet"]["method"]["method"] == "lqg"
        assert Session(study).item("laws", "quiet").ready
        assert seen.errors == []


def test_what_a_field_means_lies_beside_it_and_a_refusal_over_nothing_to_press(study):
    with served(study) as made, browser(made) as seen:
        seen.go("identify")
        seen.drawn("models-chart")
        seen.choose("identify-method", "subspace")
        seen.page.hover("[data-testid='identify-horizon']")
        seen.page.get_by_text("Left empty, it tries several").wait_for()
        seen.page.wait_for_timeout(500)  # it slides into its place
        for field in ("order", "horizon", "weight"):
            assert not seen.page.evaluate(OVER, [".q-tooltip", f"[data-testid='identify-{field}']"]), field
        seen.go("closed-loop")
        seen.click("close-loop")
        seen.page.wait_for_selector(".q-notification")
        seen.page.wait_for_timeout(500)
        for place in ("header", ".uq-side", ".uq-undo"):
            assert not seen.page.evaluate(OVER, [".q-notification", place]), place


def test_a_reduction_that_leaves_nothing_out_and_an_old_summary_say_so(study):
    (study / "summary.json").write_text("{}")
    with served(study) as made, browser(made) as seen:
        seen.go("reduce")
        seen.find("meant")
        seen.drawn("hankel-chart")
        states = Session(study).item("laws", "quiet").facts["states"]
        seen.fill("reduce-states", str(states))
        seen.click("reduce")
        seen.made("laws", "quiet-small")
        assert seen.find("nothing-gained").inner_text().startswith("quiet-small: no state is left out")
        seen.go("report")
        assert "quiet-small was made since" in seen.find("older").inner_text()
        assert seen.errors == []


def test_without_a_model_nothing_is_there_to_slide(tmp_path):
    with served(tmp_path / "study") as made, browser(made) as seen:
        seen.go("design")
        seen.page.wait_for_selector("[data-testid='no-hands']")
        assert not seen.page.is_visible("[data-testid='hands']")
