"""Text files as programs of all kinds leave them: read for what they say, or refused with what would do."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.files import read_record

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
