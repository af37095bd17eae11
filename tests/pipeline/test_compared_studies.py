"""Two studies side by side: what is compared, and what is refused."""

import json

import pytest
from test_any_bench import LIST, STUDY, TWO_MASSES

from ultraquiet._base.errors import InputError
from ultraquiet.pipeline import load_study, reload_study, walk
from ultraquiet.pipeline.report.compare import finished


@pytest.mark.parametrize("left", [{}, {"summary.json": "{}"}, {"summary.json": "[]", "study.json": "[]"}])
def test_what_is_no_finished_study_is_refused_before_anything_starts(left, tmp_path):
    for name, text in left.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="holds no finished study to compare with"):
        finished(tmp_path)


def test_the_command_refuses_it_too(run, tmp_path):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.json").write_text("{}")
    code, _, said = run("report", "study", "--compare", "nowhere")
    assert code == 2
    assert "Traceback" not in said


@pytest.mark.slow
def test_another_tone_and_another_noise_are_told_apart(tmp_path):
    for name, text in (("two_masses.py", TWO_MASSES), ("list.toml", LIST), ("study.toml", STUDY)):
        (tmp_path / name).write_text(text)
    walk(load_study(tmp_path / "study.toml"), tmp_path / "one", tmp_path, say=print)
    (tmp_path / "study.toml").write_text(STUDY.replace("noise = 1e-4", "noise = 2e-4"))
    walk(load_study(tmp_path / "study.toml"), tmp_path / "two", tmp_path, say=print)
    walk(reload_study(tmp_path / "two"), tmp_path / "two", tmp_path / "two", say=print, compare=tmp_path / "one")
    page = (tmp_path / "two" / "report.html").read_text()
    there = json.loads((tmp_path / "one" / "summary.json").read_text())["closed_loop"]["quiet"]["bench"]
    assert "<h2>Compared</h2>" in page
    assert "there: quiet, bench" in page
    assert f"<td>{there['worst_direction_band_db']:.1f}</td>" in page
    assert "<td>bench.noise</td>" in page
