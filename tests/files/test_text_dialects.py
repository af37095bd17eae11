"""Text files as programs of all kinds leave them: read for what they say, or refused with what would do."""

import re

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.files import export_record, read_record, survey
from ultraquiet.values import Channel, Record

NAMES = ["time [s]", "left coil [A]", "right coil [A]", "nose [mm/s]"]
WIRES = {"inputs": ["left coil", "right coil"], "outputs": ["nose"]}
N = 40


@pytest.fixture
def table(rng):
    return np.column_stack([np.arange(N) / 500.0, rng.standard_normal((N, 3)).round(4)])


def text(table, mark=",", end="\n", comma=False, names=NAMES, spare=""):
    rows = [mark.join(f"{v:.6g}".replace(".", "," if comma else ".") for v in row) + spare for row in table]
    return end.join([mark.join(names) + spare, *rows, ""])


DIALECTS = {
    "commas": {},
    "semicolons": {"mark": ";"},
    "tabs": {"mark": "\t"},
    "decimal commas between semicolons": {"mark": ";", "comma": True},
    "decimal commas between tabs": {"mark": "\t", "comma": True},
    "Windows line ends": {"end": "\r\n"},
    "old line ends": {"end": "\r"},
    "a comma at every end": {"spare": ","},
    "semicolons at every end": {"mark": ";", "spare": ";"},
    "names in quotes": {"names": [f'"{name}"' for name in NAMES]},
}


@pytest.mark.parametrize("coded", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_say_the_same(tmp_path, table, dialect, coded):
    (tmp_path / "run.csv").write_bytes(text(table, **DIALECTS[dialect]).encode(coded))
    record = read_record(tmp_path / "run.csv", **WIRES)
    assert record.rate_hz == 500.0
    assert [c.unit for c in (*record.actuators, *record.sensors)] == ["A", "A", "mm/s"]
    assert np.array_equal(np.vstack([record.inputs, record.outputs]), table[:, 1:].T)


def test_names_parted_by_tabs_over_columns_of_blanks(tmp_path, table):
    rows = ["\t".join(NAMES), *("   ".join(f"{v:9.4f}" for v in row) for row in table)]
    (tmp_path / "run.txt").write_text("\n".join(rows))
    assert read_record(tmp_path / "run.txt", **WIRES).samples == N


def test_a_named_column_without_numbers_stays(tmp_path, table):
    (tmp_path / "run.csv").write_text(text(table, names=[*NAMES, "spare"], spare=",").replace("spare,", "spare"))
    with pytest.raises(InputError, match=r"'spare' of .* has 40 NaN"):
        read_record(tmp_path / "run.csv", inputs=["left coil"], outputs=["spare"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda t: text(t, comma=True), "decimal commas, part the columns by semicolons or tabs"),
        (lambda t: text(t + 0.25, comma=True), "decimal commas, part the columns by semicolons or tabs"),
        (lambda t: text(t).replace("\n0.02,", "\n-,"), "write a number there, or leave the cell empty"),
        (lambda t: text(np.column_stack([t])).replace("\n0", "\n2026-11-23 10:00:0"), "not told by dates"),
        (lambda t: text(t[:0]), "holds no line of numbers"),
        (lambda t: text(t, names=["time [s]", "Spüle [A]", "b", "c"]).encode("latin-1"), "in UTF-8"),
    ],
)
def test_what_cannot_be_read_says_what_would_do(tmp_path, table, content, words):
    made = content(table)
    (tmp_path / "run.csv").write_bytes(made if isinstance(made, bytes) else made.encode())
    with pytest.raises(InputError, match=words) as refused:
        read_record(tmp_path / "run.csv", **WIRES)
    print(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("word", ["#N/A", "#DIV/0!", "#NV", "#WERT!", "NA", "n/a", "-", "5kg"])
@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 1), (7, 2), (N - 1, 3)])
@pytest.mark.parametrize("dialect", ["commas", "decimal commas between semicolons", "tabs"])
def test_a_cell_that_is_no_number_is_named_with_its_line_and_column(tmp_path, table, word, row, column, dialect):
    """Whether the file would do without the column or not: nobody knows what a word stands for."""
    settings = DIALECTS[dialect]
    lines = text(table, **settings).splitlines()
    mark = settings.get("mark", ",")
    cells = lines[row + 1].split(mark)
    cells[column] = word
    lines[row + 1] = mark.join(cells)
    (tmp_path / "run.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=re.escape(f"'{word}', which is no number")) as refused:
        read_record(tmp_path / "run.csv", **WIRES)
    said = str(refused.value)
    assert f"in line {row + 2}, column {column + 1} ('{NAMES[column].split(' [')[0]}" in said
    assert "write a number there, or leave the cell empty if the column is not used" in said


@pytest.mark.parametrize("column", [0, 1, 3])
def test_an_empty_cell_is_named_with_its_line(tmp_path, table, column):
    lines = text(table).splitlines()
    cells = lines[8].split(",")
    cells[column] = ""
    lines[8] = ",".join(cells)
    (tmp_path / "run.csv").write_text("\n".join(lines))
    name = "time column" if column == 0 else f"'{NAMES[column].split(' [')[0]}'"
    with pytest.raises(InputError, match=rf"{name} of .* has 1 NaN.* at sample 7, in line 9 \(an empty cell"):
        read_record(tmp_path / "run.csv", **WIRES)
    if column == 1:  # one that nobody names may have gaps
        assert read_record(tmp_path / "run.csv", inputs=["right coil"], outputs=["nose"]).samples == N


def test_the_clock_is_no_signal_and_goes_by_its_name_in_other_languages(tmp_path, table):
    """Numbers count the clock's column too: who takes it for a signal is told what the numbers are."""
    for name in ("time [s]", "Zeit [s]", "temps (ms)"):
        (tmp_path / "run.csv").write_text(text(table, names=[name, *NAMES[1:]]))
        assert read_record(tmp_path / "run.csv", **WIRES).rate_hz == (500e3 if "ms" in name else 500.0)
        with pytest.raises(InputError, match=r"is the clock of 'run.csv', no signal.* 2 left coil, 3 right coil"):
            read_record(tmp_path / "run.csv", inputs="1-2", outputs="3-4")
        assert read_record(tmp_path / "run.csv", inputs="2-3", outputs="4").sensors[0].name == "nose"
        with pytest.raises(InputError, match="--inputs 2-3 --outputs 4"):
            read_record(tmp_path / "run.csv")
    (tmp_path / "run.csv").write_text(text(table, names=["Uhr [s]", *NAMES[1:]]))
    with pytest.raises(InputError, match=r"--rate .* or name 'Uhr', which rises evenly, 'time' if it is the clock"):
        read_record(tmp_path / "run.csv", **WIRES)


def test_units_behind_a_slash_are_units_and_a_ratio_is_a_name(tmp_path, table):
    """So ISO 80000 heads the columns of a table."""
    names = ["t / s", "left coil / A", "right coil / mA", "nose / mm/s"]
    (tmp_path / "run.csv").write_text(text(table, names=names))
    record = read_record(tmp_path / "run.csv", inputs=["left coil", "right coil"], outputs=["nose"])
    assert record.rate_hz == 500.0
    assert [c.unit for c in (*record.actuators, *record.sensors)] == ["A", "mA", "mm/s"]
    (tmp_path / "run.csv").write_text(text(table, names=[*names[:3], "nose / tail"]))
    assert survey(tmp_path / "run.csv").channels[-1].name == "nose / tail"


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("nose / (m/s^2)", "nose", "m/s^2"),
        ("nose/(m/s²)", "nose", "m/s²"),
        ("nose / [m s⁻²]", "nose", "m s⁻²"),
        ("nose / m/s2", "nose", "m/s2"),
        ("nose / N/(m/s)", "nose", "N/(m/s)"),
        ("nose / (kg m/s^2)", "nose", "kg m/s^2"),
        ("nose / um", "nose", "um"),
        ("nose [V/(m/s)]", "nose", "V/(m/s)"),
        ("nose (m/s^2)", "nose", "m/s^2"),
        ("nose (left) [V]", "nose (left)", "V"),
        ("nose / N/(m s2)", "nose", "N/(m s2)"),
        ("nose / (tail / um)", "nose / (tail / um)", ""),
        ("nose / (tail)", "nose / (tail)", ""),
        ("nose / A2", "nose / A2", ""),
        ("nose / 12", "nose / 12", ""),
    ],
)
def test_units_of_several_are_told_from_names(tmp_path, table, header, name, unit):
    (tmp_path / "run.csv").write_text(text(table, names=[*NAMES[:-1], header]))
    found = survey(tmp_path / "run.csv").channels[-1]
    assert (found.name, found.unit) == (name, unit)


def test_a_name_that_would_come_back_as_another_is_not_written(tmp_path, rng):
    y = rng.standard_normal((1, 8))
    for name, unit, kept in (("nose /", "V", False), ("nose / um", "", True), ("nose / tail", "mm/s^2", True)):
        record = Record(y, y, 500.0, sensors=[Channel(name, unit)])
        if kept:
            (back,) = read_record(export_record(record, tmp_path / f"{len(name)}.csv")).sensors
            assert (back.name, back.unit) == (name, unit)
        else:
            with pytest.raises(InputError, match="'nose /' with unit 'V' cannot stand in a line of text"):
                export_record(record, tmp_path / "run.csv")


def test_units_in_a_line_of_their_own_keep_the_brackets_within_them(tmp_path, table):
    names, *rows = text(table, names=["time", "left", "right", "nose"]).splitlines()
    (tmp_path / "run.csv").write_text("\n".join([names, "[s],[A],(mA),V/(m/s)", *rows]))
    record = read_record(tmp_path / "run.csv", inputs=["left", "right"], outputs=["nose"])
    assert [c.unit for c in (*record.actuators, *record.sensors)] == ["A", "mA", "V/(m/s)"]


def test_a_column_that_drifts_is_no_clock_and_stops_no_look_at_the_file(tmp_path, rng):
    steps = 1e-3 * np.where(np.arange(4000) < 2000, 1.0, 1.0008)
    rows = np.column_stack([np.cumsum(steps), rng.standard_normal((4000, 3))])
    (tmp_path / "run.csv").write_text(text(rows, names=["Uhr", *NAMES[1:]]))
    found = survey(tmp_path / "run.csv")
    assert (found.rate_hz, found.clock, found.clock_hz) == (None, "", None)
    assert len(found.channels) == 4


def test_a_remark_behind_numbers_is_none_of_them(tmp_path, table):
    lines = text(table).splitlines()
    lines[1] += " # touched by hand"
    lines.insert(9, "# the bench was touched")
    (tmp_path / "run.csv").write_text("\n".join(lines))
    assert read_record(tmp_path / "run.csv", **WIRES).samples == N


@pytest.mark.parametrize("mark", [",", "\t", ";"])
@pytest.mark.parametrize("end", ["", "\t"])
def test_a_column_with_gaps_hides_no_other(tmp_path, table, mark, end):
    """An empty cell is none whatever parts the cells, in the first line of numbers as well."""
    for first in (0, 1):
        rows = [
            f"{mark.join(f'{v:.6g}' for v in row)}{mark}{k if k % 3 == first else ''}" for k, row in enumerate(table)
        ]
        spare = end if mark == "\t" else ""
        (tmp_path / "run.tsv").write_text("\n".join(row + spare for row in (mark.join([*NAMES, "aux"]), *rows)))
        record = read_record(tmp_path / "run.tsv", **WIRES)
        assert record.rate_hz == 500.0
        assert np.array_equal(record.outputs[0], table[:, 3])
        with pytest.raises(InputError, match=r"'aux' of .* has 26 NaN" if first == 0 else r"'aux' of .* has 27 NaN"):
            read_record(tmp_path / "run.tsv", inputs="left coil", outputs="aux")


@pytest.mark.parametrize("mark", [",", "\t", ";"])
def test_a_column_without_a_name_takes_none_from_the_others(tmp_path, table, mark):
    """A data frame is written so: the count of its rows stands first, without a name."""
    rows = [[str(k), *(f"{v:.6g}" for v in row)] for k, row in enumerate(table)]
    (tmp_path / "run.csv").write_text("\n".join(mark.join(row) for row in (["", *NAMES], *rows)))
    record = read_record(tmp_path / "run.csv", **WIRES)
    assert record.rate_hz == 500.0
    assert np.array_equal(record.outputs[0], table[:, 3])
    assert [c.name for c in survey(tmp_path / "run.csv").channels][:2] == ["column 1", "left coil"]
    titled = [["Bench 3", "", "", "", ""], *rows]
    (tmp_path / "run.csv").write_text("\n".join(mark.join(row) for row in titled))
    assert [c.name for c in survey(tmp_path / "run.csv", 1.0).channels] == [f"column {k}" for k in range(1, 6)]


def test_tabs_that_end_padded_numbers_part_nothing(tmp_path, table):
    (tmp_path / "run.dat").write_text("\n".join("".join(f" {v: .4f} \t" for v in row) for row in table))
    record = read_record(tmp_path / "run.dat", 500.0, "2-3", "4")
    assert np.allclose(record.outputs[0], table[:, 3], atol=1e-4)
