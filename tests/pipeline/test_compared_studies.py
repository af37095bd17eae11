"""Two studies side by side: what is compared, and what is refused."""

import json
import re

import pytest
from test_any_bench import LIST, STUDY, TWO_MASSES

from ultraquiet._base.errors import InputError
from ultraquiet.pipeline import load_study, reload_study, walk
from ultraquiet.pipeline.report.compare import finished
from ultraquiet.pipeline.report.naming import NamedStudy, told_apart

BROKEN = [
    {},
    {"summary.json": "{}"},
    {"summary.json": "[]", "study.json": "[]"},
    {"summary.json": "{}", "study.json": '{"bench": 3}'},
]


@pytest.mark.parametrize("left", BROKEN)
def test_what_is_no_finished_study_is_refused_before_anything_starts(left, tmp_path):
    for name, text in left.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="holds no finished study to compare with"):
        finished(tmp_path, tmp_path)


def test_the_command_refuses_it_too(run, tmp_path):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.json").write_text("{}")
    code, _, said = run("report", "study", "--compare", "nowhere")
    assert code == 2
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("title", "bench", "folder", "names"),
    [
        ("Loud", "hexapod", "runs/b", ("Quiet", "Loud")),
        ("Quiet", "plant.py", "runs/b", ("Quiet on hexapod", "Quiet on plant.py")),
        ("Quiet", "hexapod", "runs/b", ("Quiet in a", "Quiet in b")),
        ("Quiet", "hexapod", "b/runs/a", ("Quiet in HERE/runs/a", "Quiet in b/runs/a")),
        ("Quiet", "hexapod", "other/a", ("Quiet in runs/a", "Quiet in other/a")),
        ("Quiet", "hexapod", "runs/a", ("Quiet", "Quiet")),
    ],
)
def test_names_are_no_longer_than_it_takes_to_tell_two_studies_apart(title, bench, folder, names, tmp_path):
    one = NamedStudy("Quiet", "hexapod", tmp_path / "runs" / "a")
    found = told_apart(one, NamedStudy(title, bench, tmp_path / folder))
    assert found == tuple(name.replace("HERE", tmp_path.name) for name in names)


@pytest.mark.slow
def test_another_tone_and_another_noise_are_told_apart(tmp_path):
    for name, text in (("two_masses.py", TWO_MASSES), ("list.toml", LIST), ("study.toml", STUDY)):
        (tmp_path / name).write_text(text)
    walk(load_study(tmp_path / "study.toml"), tmp_path / "one", tmp_path, say=print)
    (tmp_path / "study.toml").write_text(STUDY.replace("noise = 1e-4", "noise = 2e-4"))
    walk(load_study(tmp_path / "study.toml"), tmp_path / "two", tmp_path, say=print)
    walk(reload_study(tmp_path / "two"), tmp_path / "two", tmp_path / "two", say=print, compare=tmp_path / "one")
    page = (tmp_path / "two" / "report.html").read_text()
    summary = json.loads((tmp_path / "one" / "summary.json").read_text())
    there = summary["closed_loop"]["quiet"]["bench"]
    assert "<h2>Compared</h2>" in page
    named = [f"{summary['title']} in {folder}" for folder in ("two", "one")]
    assert all(f"{name}: quiet, bench" in page for name in named)
    assert "<th>{}</th><th>{}</th>".format(*named) in re.sub(r"<th [^>]*>", "<th>", page)
    assert f"<td>{there['worst_direction_band_db']:.1f}</td>" in page
    assert ">bench.noise</td>" in page
