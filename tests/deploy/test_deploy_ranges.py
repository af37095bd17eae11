"""What commands are held to, and what readings may come to: the channels' own, or as stated, never another bench's."""

import json

import numpy as np
import pytest
import uq_command

from ultraquiet import files
from ultraquiet.cli.deploy.ranges import requested_limits, requested_range, requested_size, unsaid
from ultraquiet.deploy import C31Budget, generate
from ultraquiet.values import Channel, StateSpace

COILS = (Channel("left coil", "N", -3.0, 4.0), Channel("right coil", "N"))
SPEEDS = (Channel("speed", "m/s", -2e-3, 2e-3),)


@pytest.fixture
def law():
    D = np.zeros((2, 1))
    return StateSpace([[0.5]], [[0.1]], [[1.0], [2.0]], D, 2000.0, actuators=SPEEDS, sensors=COILS)


def test_a_law_is_held_to_the_limits_of_its_own_actuators(law, tmp_path):
    made = generate(law, tmp_path / "code")
    assert made.law.limits.tolist() == [[-3.0, 4.0], [-25.0, 25.0]]
    assert made.tables["commands"] == ["left coil -3 to 4 N", "right coil -25 to 25 N"]
    assert made.tables["measurements"] == ["speed (m/s)"]
    read_me = (tmp_path / "code" / "README.md").read_text()
    assert "left coil -3 to 4 N, right coil -25 to 25 N" in read_me
    assert generate(law, tmp_path / "stated", limits_v=2.0).law.limits.tolist() == [[-2.0, 2.0]] * 2


def test_limits_are_stated_for_all_or_for_each(law):
    assert requested_limits(None, law).tolist() == [[-3.0, 4.0], [-25.0, 25.0]]
    assert requested_limits("7", law).tolist() == [[-7.0, 7.0]] * 2
    assert requested_limits("-1:2,5", law).tolist() == [[-1.0, 2.0], [-5.0, 5.0]]
    assert (requested_size(None, law), requested_size("7", law)) == (3.0, 7.0)
    assert (requested_range(None, law), requested_range("1e-4", law)) == (2e-3, 1e-4)


def test_what_nobody_stated_is_said(law):
    ranges = requested_limits(None, law)
    said = unsaid(None, law.sensors, ranges, "--limits", "may come to")
    assert said == ("nobody says what right coil may come to: taken as -25 to 25 N; state it with --limits",)
    assert not unsaid("7", law.sensors, ranges, "--limits", "may come to")
    assert not unsaid(None, law.actuators, ranges[:1], "--range", "can come to")


def test_the_budget_of_a_frame_is_that_of_the_law_s_own_rate(law, tmp_path):
    made = {
        rate: generate(StateSpace(law.A, law.B, law.C, law.D, rate), tmp_path / f"{rate:g}") for rate in (3500.0, 8e3)
    }
    assert [each.tables["c31_budget"] for each in made.values()] == [2800, 1225]
    assert C31Budget(cycles=2000, share=0.5).allowed_at(8e3) == 1000.0


@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("precision", ["q31", pytest.param("float32", marks=pytest.mark.slow)])
def test_the_command_states_its_limits(law, tmp_path, monkeypatch, capsys, precision):
    files.save(law, tmp_path / "law.h5")
    words = ["--precision", precision, "--steps", "100", *([] if precision == "q31" else ["--target", "none"])]
    code, out, _ = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "law.h5", *words)
    assert code == 0
    assert "right coil may come to: taken as" in out
    asked = ("deploy", tmp_path / "law.h5", "--out", tmp_path / "new", *words, "--limits", "6", "--json")
    code, out, _ = uq_command.called(monkeypatch, capsys, *asked)
    assert code == 0
    held = json.loads(out)["tables"].get("commands", ["left coil -6 to 6 N"])
    assert held[0] == "left coil -6 to 6 N"
