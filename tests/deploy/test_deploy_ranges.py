"""What commands are held to, and what readings may come to: the channels' own, or as stated, never another bench's."""

import json

import numpy as np
import pytest
import uq_command

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet.cli.deploy.ranges import requested_limits, requested_range
from ultraquiet.deploy import C31Budget, fixed_law, generate, generate_fixed, word_lengths
from ultraquiet.deploy.c_code.self_test import ScriptPlayer, script_calls
from ultraquiet.values import Channel, StateSpace

COILS = (Channel("left coil", "N", -3.0, 4.0), Channel("right coil", "N"))
SPEEDS = (Channel("speed", "m/s", -2e-3, 2e-3),)


@pytest.fixture
def law():
    D = np.zeros((2, 1))
    return StateSpace([[0.5]], [[0.1]], [[1.0], [2.0]], D, 2000.0, actuators=SPEEDS, sensors=COILS)


def test_a_law_is_held_to_the_limits_of_its_own_actuators_alone(law, tmp_path):
    made = generate(law, tmp_path / "code")
    assert made.law.limits.tolist() == [[-3.0, 4.0], [-(2.0**64), 2.0**64]]
    assert made.law.known_limits.tolist() == [[-3.0, 4.0], [-np.inf, np.inf]]
    assert made.tables["commands"] == ["left coil -3 to 4 N", "right coil (N), not limited"]
    assert made.tables["measurements"] == ["speed (m/s)"]
    said = "No limit of 'right coil' is known, and the code keeps no other; limits_v (--limits) sets it."
    assert made.status.ok
    assert made.status.sentence.endswith(said)
    read_me = (tmp_path / "code" / "README.md").read_text()
    assert "left coil -3 to 4 N, right coil (N), not limited" in read_me
    assert said in read_me
    stated = generate(law, tmp_path / "stated", limits_v=2.0)
    assert stated.law.limits.tolist() == [[-2.0, 2.0]] * 2
    assert "No limit" not in str(stated.status)


def test_one_end_may_be_known_alone(tmp_path):
    coils = (Channel("up", "N", low=-3.0), Channel("down", "N", high=4.0))
    made = generate(StateSpace([[0.5]], [[0.1]], [[1.0], [2.0]], np.zeros((2, 1)), 2e3, sensors=coils), tmp_path / "c")
    assert made.law.known_limits.tolist() == [[-3.0, np.inf], [-np.inf, 4.0]]
    assert made.tables["commands"] == ["up (N), limited below at -3 only", "down (N), limited above at 4 only"]
    assert "One limit alone of 'up', 'down' is known" in made.status.sentence
    table = (tmp_path / "c" / "controller_coefficients.h").read_text()
    assert "/* actuator limits, low and high; 0x1.0000000000000p+64f where none is known */" in table
    aside = (Channel("x", "N", low=1.0), Channel("y", "N"))
    with pytest.raises(InputError, match="range in the channels of the law must hold 0, where the ramp ends"):
        generate(StateSpace([[0.5]], [[0.1]], [[1.0], [2.0]], np.zeros((2, 1)), 2e3, sensors=aside), tmp_path / "c")


@pytest.mark.gate("False-float64")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_code_without_limits_has_every_guard_and_its_proof(tmp_path, precision, anti_windup):
    """The self-test still meets the end that stands where none is known, and nothing overflows on the way there."""
    law = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[1e-3], [0.0]], [[1.0, 0.0]], [[0.1]], rate_hz=2000.0)
    made = generate(law, tmp_path / "code", precision, anti_windup=anti_windup, ramp_s=0.005)
    assert made.verify(steps=3000, targets=(), fuzz_steps=0).ok
    player, calls = ScriptPlayer(made.law), script_calls(made.law, made.plan.quiet, made.plan.loud)
    loud = next(k for k, call in enumerate(calls) if call[0] == "RUN" and call[2] == made.plan.loud)
    for call in calls[: loud + 1]:
        player.play(*call)
    assert player.twin.clipped > 10
    assert player.twin.faults == 0
    u = made.instance().step(np.array([1e9]))  # what another bench's range would have cut
    assert u[0] == np.float32(1e8) if precision == "float32" else u[0] == 1e8


def test_a_converter_needs_a_range(law, tmp_path):
    asked = {"form": "modal", "targets": ("c99", "c31")}
    with pytest.raises(InputError, match="nobody says how far they may go; state the actuators' range, or the conv"):
        generate(law, tmp_path / "code", **asked)
    assert not (tmp_path / "code").exists()
    assert (generate(law, tmp_path / "code", limits_v=3.0, **asked).folder / "controller_c31.asm").exists()


def test_whole_numbers_need_ranges(law, tmp_path):
    with pytest.raises(InputError, match=r"nobody says what 'right coil' may come to; state it with output_v \(--lim"):
        generate_fixed(law, tmp_path / "code")
    bare = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz)
    with pytest.raises(InputError, match=r"nobody says what 'input 1' can come to; state it with input_v \(--range\)"):
        fixed_law(bare, output_v=1.0)
    rows = word_lengths(law, precisions=("float32", "q31"))
    assert rows[0].status.ok
    assert all(row.status.word == "refused" and "--limits" in str(row.status) for row in rows if row.precision == "q31")
    known = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz, SPEEDS, (COILS[0], Channel("right coil", "N", -5, 6)))
    made = fixed_law(known)
    assert (made.input_v, made.output_v) == (2e-3, 3.0)
    pushing = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz, SPEEDS, (COILS[0], Channel("right coil", "N", 0, 6)))
    with pytest.raises(InputError, match="one size on both sides of zero, and 'right coil' goes from 0 to 6 N"):
        fixed_law(pushing)


@pytest.mark.parametrize(
    ("stated", "size", "more"),
    [
        (30.0, 30.0, ""),
        ([[-40.0, 30.0], [-30.0, 30.0]], 30.0, "+-30: of left coil -40 to 30 N they leave the rest unused."),
        ([7.0, 5.0], 5.0, "+-5: of left coil -7 to 7 N they leave the rest unused."),
        (None, 3.0, "+-3: of left coil -3 to 4 N, right coil -5 to 6 N they leave the rest unused."),
    ],
)
def test_what_whole_numbers_leave_of_limits_is_said(law, tmp_path, stated, size, more):
    wires = (COILS[0], Channel("right coil", "N", -5.0, 6.0))
    known = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz, SPEEDS, wires)
    made = generate_fixed(known, tmp_path / "code", output_v=stated)
    assert made.law.output_v == size
    said = f"Whole numbers hold all commands to one size, {more}"
    assert made.status.sentence.endswith(said) if more else "one size" not in made.status.sentence
    assert made.tables["commands"] == [f"left coil {-size:g} to {size:g} N", f"right coil {-size:g} to {size:g} N"]
    assert made.tables["measurements"] == ["speed -0.002 to 0.002 m/s"]
    read_me = (tmp_path / "code" / "README.md").read_text()
    assert f"left coil {-size:g} to {size:g} N, right coil {-size:g} to {size:g} N" in read_me
    assert "speed -0.002 to 0.002 m/s" in read_me
    assert (said in read_me) is bool(more)


@pytest.mark.parametrize("call", [fixed_law, word_lengths])
def test_limits_that_whole_numbers_cannot_hold_are_refused(law, call):
    said = []
    try:
        said += [str(row.status) for row in call(law, output_v=[[-5.0, 5.0], [0.0, 6.0]]) if row.precision == "q31"]
    except InputError as refusal:
        said.append(str(refusal))
    assert all("one size on both sides of zero, and 'right coil' goes from 0 to 6 N" in each for each in said)
    assert said
    for wrong in ([[1.0, 2.0], [-1.0, 1.0]], [1.0, 2.0, 3.0], -1.0):
        with pytest.raises(InputError, match="output_v"):
            call(law, output_v=wrong)


def test_whole_numbers_are_told_in_the_units_of_the_law_s_own_channels(tmp_path):
    ends = {
        "A measurement of 3 m/s and a command of 5 N are 2^31.": (SPEEDS, COILS[:1]),
        "A measurement of 3 (m/s, V) and a command of 5 (N, no unit, A) are 2^31.": (
            (*SPEEDS, Channel("gauge", "V"), Channel("probe", "V")),
            (COILS[0], Channel("valve"), Channel("coil", "A"), COILS[1]),
        ),
        "A measurement of 3 and a command of 5 are 2^31.": (("a", "b", "c"), ("d", "e", "f", "g", "h")),
        "A measurement of 3 * /x and a command of 5 are 2^31.": ((Channel("odd", "*/x"),), ("d",)),
    }
    for k, (said, (y, u)) in enumerate(ends.items()):
        law = StateSpace(
            [[0.5]], 0.1 * np.ones((1, len(y))), np.ones((len(u), 1)), np.zeros((len(u), len(y))), 2e3, y, u
        )
        generate_fixed(law, tmp_path / str(k), "q31", input_v=3.0, output_v=5.0)
        assert f" * Whole numbers only. {said}\n" in (tmp_path / str(k) / "controller.h").read_text()


def test_limits_are_stated_for_all_or_for_each(law):
    assert requested_limits(None, law) is None
    assert requested_limits("7", law).tolist() == [[-7.0, 7.0]] * 2
    assert requested_limits("-1:2,5", law).tolist() == [[-1.0, 2.0], [-5.0, 5.0]]
    assert (requested_range(None), requested_range("1e-4")) == (None, 1e-4)


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
    code, out, err = uq_command.called(monkeypatch, capsys, "deploy", tmp_path / "law.h5", *words)
    assert code == (2 if precision == "q31" else 0)
    assert "'right coil'" in out + err
    assert "--limits" in out + err
    asked = ("deploy", tmp_path / "law.h5", "--out", tmp_path / "new", *words, "--limits", "6", "--json")
    code, out, _ = uq_command.called(monkeypatch, capsys, *asked)
    assert code == 0
    assert json.loads(out)["tables"]["commands"] == ["left coil -6 to 6 N", "right coil -6 to 6 N"]


def test_the_table_of_word_lengths_takes_ranges(law, tmp_path, monkeypatch, capsys):
    files.save(law, tmp_path / "law.h5")
    asked = ("deploy", tmp_path / "law.h5", "--word-lengths")
    code, out, err = uq_command.called(monkeypatch, capsys, *asked)
    assert code == 0
    assert "nobody says what 'right coil' may come to" in " ".join((out + err).split())
    code, out, err = uq_command.called(monkeypatch, capsys, *asked, "--limits", "6")
    assert code == 0
    assert "refused" not in out + err
    code, out, _ = uq_command.called(monkeypatch, capsys, *asked, "--limits=-40:30,30")
    assert code == 0
    assert "one size, +-30: of left coil -40 to 30 N they leave the rest unused." in " ".join(out.split())
