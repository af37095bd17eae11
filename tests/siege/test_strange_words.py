"""What people may name, number or write strangely: names that no file holds, mark-up in names, numbers beyond all."""

import json
import re

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.tables import settings_object
from ultraquiet.deploy import generate, generate_fixed
from ultraquiet.deploy.c31.cycles import kernel_cycles, largest_order, skeleton_cycles
from ultraquiet.files.channel_rows import from_rows

EVIL = "a <script>alert(1)</script>\n## h | x\x00\x1b[31m\u202e [go](http://x) */ $(shell x) ??/"


@pytest.mark.parametrize("field", ["name", "unit"])
def test_half_a_pair_of_utf_16_is_no_name(field):
    with pytest.raises(InputError, match=r"'push\\ud800' is no text that can be written"):
        uq.Channel(**({"name": "push"} | {field: "push\ud800"}))


def test_a_page_holds_what_people_named_as_plain_text(tmp_path):
    law = uq.StateSpace(
        [[0.5]], [[0.1]], [[1.0]], [[0.0]], 100.0, [uq.Channel(EVIL, "m/s")], [uq.Channel(EVIL, "N", -1, 1)]
    )
    text = (generate(law, tmp_path / "code").folder / "README.md").read_text(encoding="utf-8")
    (row,) = (line for line in text.splitlines() if line.startswith("| commands"))
    assert len(re.findall(r"(?<!\\)\|", row)) == 3
    assert not re.search(r"(?<!\\)<[A-Za-z/]", row)
    assert not re.search(r"(?<!\\)\]\(", row)
    assert row.isprintable()


@pytest.mark.parametrize("name", ["test", "install", "cmake_c"])
def test_names_that_cmake_keeps_are_refused(tmp_path, name):
    law = uq.StateSpace([[0.5]], [[0.1]], [[1.0]], [[0.0]], 100.0)
    with pytest.raises(InputError, match="CMake keeps for itself"):
        generate(law, tmp_path / "code", name=name)
    assert not (tmp_path / "code").exists()


@pytest.mark.parametrize("name", ["float", "stdint", "strings"])
def test_names_that_would_hide_headers_of_c_are_refused(tmp_path, name):
    law = uq.StateSpace([[0.5]], [[0.1]], [[1.0]], [[0.0]], 100.0, None, [uq.Channel("u", "V", -1, 1)])
    for make in (generate, generate_fixed):
        with pytest.raises(InputError, match=f"would hide the header <{name}.h> of C; take another"):
            make(law, tmp_path / "code", name=name)
    assert not (tmp_path / "code").exists()


def test_a_law_of_zeros_has_a_gain_of_zeros(tmp_path):
    law = uq.StateSpace(
        np.zeros((2, 2)), np.zeros((2, 1)), np.zeros((1, 2)), [[0.0]], 10.0, None, [uq.Channel("u", "", -1, 1)]
    )
    assert generate(law, tmp_path / "code", anti_windup=True).status.ok


def test_numbers_beyond_all_floats_are_taken_or_refused_in_a_sentence():
    huge = 10**400
    mistakes = Mistakes()
    settings_object("signals", "tone", {"frequency_hz": huge, "amplitude": huge}, (), mistakes)
    assert mistakes.by_line()
    with pytest.raises(ValueError, match="a limit of channel 'f' is beyond all numbers"):
        from_rows(json.loads(f'[["f", "N", 0.0, {huge}]]'))


@pytest.mark.parametrize("form", ["dense", "modal", "delta"])
@pytest.mark.parametrize("shape", [(1, 1), (6, 6), (4, 3)])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_the_largest_order_is_the_last_that_fits(form, shape, anti_windup):
    stride = 1 if form == "dense" else 2
    for budget in (150, 500, 1500, 4000, 9000):
        frame = skeleton_cycles(*shape, anti_windup=anti_windup)
        fitting = [
            n
            for n in range(0, 2000, stride)
            if n and frame + kernel_cycles(form, n, *shape, anti_windup=anti_windup) <= budget
        ]
        assert largest_order(form, budget, *shape, anti_windup=anti_windup) == (fitting[-1] if fitting else 0)
    assert largest_order(form, 10**13, *shape) > 10**6


@pytest.mark.parametrize("rows", ["0,1.2.3,1\n0.1,9..,2\n", "0,0x1p3,1\n", "0,1,1\n0.1,x,2\n"])
def test_damaged_first_rows_are_not_names_and_units(tmp_path, rows):
    path = tmp_path / "dots.csv"
    path.write_text(f"time,force,speed\n{rows}0.2,3,3\n0.3,3,4\n0.4,3,5\n")
    with pytest.raises(InputError, match=r"which is no number, stands in line [23], column 2 \('force'\)"):
        uq.files.read_record(path, inputs=["force"], outputs=["speed"])


def test_words_above_the_names_stay_words(tmp_path):
    path = tmp_path / "words.csv"
    path.write_text("Instrument,Model,Serial\nX,Y,12345\ntime,force,speed\n0.1,1,2\n0.2,3,3\n0.3,3,4\n")
    record = uq.files.read_record(path, inputs=["force"], outputs=["speed"])
    assert [c.name for c in (*record.actuators, *record.sensors)] == ["force", "speed"]
    assert record.rate_hz == pytest.approx(10.0)
