"""`ultraquiet campaign`: a user's own bench drawn from a study file, interrupted, resumed, a case evaluated again."""

import json
import shlex
import shutil
from pathlib import Path

import pytest

HERE = Path(__file__).parents[1] / "simulate" / "drawable.py"
LIST = """
title = "noise"
[[commands]]
do = "configure"
samples = 4000
[[commands]]
do = "excite"
name = "all"
actuator = "all"
signal = { method = "noise", stop_hz = 90.0, peak_v = 5.0 }
"""
STUDY = """
[study]
title = "one mass"
[bench]
object = "drawable.py:Drawable"
[experiment]
list = "list.toml"
[plant]
method = "subspace"
records = ["all"]
order = 4
[controllers.calm.design]
method = "lqg"
band_hz = [3.0, 8.0]
[closed_loop]
band_hz = [3.0, 8.0]
"""


@pytest.fixture
def study(tmp_path):
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(STUDY)
    shutil.copy(HERE, tmp_path / "drawable.py")
    return tmp_path


@pytest.mark.slow
def test_a_users_bench_is_drawn_and_one_case_comes_out_again(study, run):
    (study / "study.toml").write_text(STUDY + "[campaign]\nmeasured = 2\n")
    code, out, err = run("campaign", "study.toml", "--benches", "6", "--workers", "1")
    print(out, err)
    summary = json.loads((study / "study" / "campaign.json").read_text())
    assert summary["measured"]["benches"] == 2
    assert "2 measured" in out
    assert code == (0 if summary["stable"] == 6 else 1)
    assert summary["law"] == "calm"
    assert "drawn benches (truth)" in out
    worst = summary["worst"][0]
    _, told, _ = run(*shlex.split(worst["replay"])[1:], "--json")
    again = json.loads(told)
    assert again["peak_db"] == pytest.approx(worst["peak_db"], abs=1e-9)
    code, out, err = run("campaign", "study.toml", "--benches", "8", "--workers", "1", "--resume")
    lines = (study / "study" / "campaign" / "results.jsonl").read_bytes().splitlines()
    assert len(lines) == 1 + 8


COUNTING = """


class Counting:
    rate_hz = RATE_HZ

    def __init__(self, own=None):
        self.own, self.runs = own or Drawable(), 0

    def drawn(self, seed):
        return Counting(self.own.drawn(seed))

    def linear_model(self):
        return self.own.linear_model()

    actuators = property(lambda self: self.own.actuators)
    sensors = property(lambda self: self.own.sensors)

    def run(self, *given, **more):
        self.runs += 1
        return self.own.run(*given, **more)
"""


def test_a_campaign_of_a_plain_class_is_resumed_by_the_next_process(study, run):
    """It holds other numbers once its records were made, and no settings that anybody could compare."""
    (study / "study.toml").write_text(STUDY.replace(":Drawable", ":Counting"))
    (study / "drawable.py").write_text((study / "drawable.py").read_text() + COUNTING)
    for benches, more in (("2", []), ("3", ["--resume"])):
        code, _, err = run("campaign", "study.toml", "--benches", benches, "--workers", "1", *more)
        print(err)
        assert code < 2
    assert len((study / "study" / "campaign" / "results.jsonl").read_bytes().splitlines()) == 1 + 3


ODD = "Rüttler 1/it's out"


@pytest.mark.parametrize(
    ("command", "folder"),
    [("campaign", "out"), ("campaign", ODD), pytest.param("run", ODD, marks=pytest.mark.slow)],
)
def test_the_command_that_is_printed_repeats_its_case_where_the_results_are(command, folder, study, run):
    """As a shell takes it apart, of a name with blanks, quotes and letters of other scripts too."""
    name = Path("Prüfling 1.toml")
    (study / name).write_text(STUDY + "[campaign]\nbenches = 2\nkeep = 1\n")
    _, out, err = run(command, str(name), "--out", folder, *(["--workers", "1"] if command == "campaign" else []))
    print(out, err)
    (worst,) = json.loads((study / folder / "campaign.json").read_text())["worst"]
    before = sorted(study.iterdir())
    program, *words = shlex.split(worst["replay"])
    code, told, err = run(*words, "--json")
    print(worst["replay"], told, err)
    assert (program, code) == ("ultraquiet", 0 if worst["stable"] else 1)
    assert json.loads(told)["peak_db"] == pytest.approx(worst["peak_db"], abs=1e-9)
    assert sorted(study.iterdir()) == before
    assert command == "run" or worst["replay"] in out


def test_what_cannot_be_drawn_is_refused_with_its_line(study, run):
    (study / "drawable.py").write_text((study / "drawable.py").read_text().replace("def drawn(", "def cast("))
    (study / "study.toml").write_text(STUDY + "[campaign]\nbenches = 4\n")
    code, _, err = run("campaign", "study.toml")
    print(err)
    assert code == 2
    assert "line 17: campaign: a Drawable cannot be drawn; give it a method 'drawn(seed)'" in err
    (study / "study.toml").write_text(STUDY + '[campaign]\nlaw = "clam"\n')
    code, _, err = run("campaign", "study.toml")
    assert code == 2
    assert "there is no law 'clam' among the controllers calm" in err
    (study / "study.toml").write_text(STUDY + "[campaign]\nbenches = 4\ntune = true\n")
    code, _, err = run("campaign", "study.toml")
    assert code == 2
    assert 'line 19: campaign.tune: it fits responses; give [plant] the method "rational"' in err
    assert not (study / "study").exists()
    (study / "study.toml").write_text(STUDY + '[campaign]\non = "bench"\nmeasured = 3\n')
    code, _, err = run("campaign", "study.toml")
    assert code == 2
    assert "line 17: " in err
    assert 'with on = "bench" every bench is measured; leave' in err
