"""Mappings: what they do to channels, and all their mistakes at once with their lines."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet.files.mapping import MappingError, load_mapping, parse_mapping
from ultraquiet.values import Channel, Record

read = files.read_record

MAPPING = """
rate_hz = 500.0
crop_s = [0.01, 0.05]

[[inputs]]
column = "drive"
name = "strut 1"
unit = "V"
scale = 2.5
limits = [-25.0, 25.0]

[[outputs]]
column = 4          # counted from one, time included
unit = "mm/s"
scale = -1000.0
offset = 0.5

[[outputs]]
column = "left"
"""


@pytest.fixture
def table(tmp_path, rng):
    """A semicolon table with decimal commas; the last sample, outside the cut, is missing."""
    values = np.round(rng.standard_normal((3, 40)), 6)
    rows = [";".join(f"{v:.6f}".replace(".", ",") for v in (k / 1000, *values[:, k])) for k in range(40)]
    rows[39] = rows[39].rpartition(";")[0] + ";"
    path = tmp_path / "run.csv"
    path.write_text("time;drive;left;right\ns;V;m/s;m/s\n" + "\n".join(rows) + "\n")
    return path, values


def test_a_mapping_applied(tmp_path, table):
    path, values = table
    (tmp_path / "map.toml").write_text(MAPPING)
    record = read(path, mapping=tmp_path / "map.toml")
    # 500 Hz instead of the file's 1000: the cut from 0.01 to 0.05 s are samples 5 to 24.
    assert (record.rate_hz, record.samples) == (500.0, 20)
    assert record.actuators == (Channel("strut 1", "V", -25.0, 25.0),)
    assert [(c.name, c.unit) for c in record.sensors] == [("right", "mm/s"), ("left", "m/s")]
    np.testing.assert_array_equal(record.inputs[0], 2.5 * values[0, 5:25])
    np.testing.assert_array_equal(record.outputs, [-1000.0 * values[2, 5:25] + 0.5, values[1, 5:25]])
    assert record.provenance.settings["mapping"] == MAPPING
    assert read(path, mapping=load_mapping(tmp_path / "map.toml")).hash == record.hash
    assert read(path, 250.0, mapping=tmp_path / "map.toml").rate_hz == 250.0


def test_without_a_mapping_the_gap_shows(table):
    path, _ = table
    with pytest.raises(InputError, match=r"'right' of 'run\.csv' has 1 NaN or infinite values, the first at sample 39"):
        read(path, inputs="drive", outputs="right")
    back = read(path, inputs="drive", outputs="left")
    assert (back.rate_hz, back.sensors[0].unit) == (1000.0, "m/s")


def test_an_archive_mapped(tmp_path, rng):
    record = Record(
        rng.standard_normal((1, 20)), rng.standard_normal((2, 20)), 100.0, ["a"], [Channel("b", "g", -1, 2), "c"]
    )
    path = files.save(record, tmp_path / "a.h5")
    mapping = parse_mapping('[[inputs]]\ncolumn="a"\n[[outputs]]\ncolumn="b"\nscale=-9.81\nunit="m/s²"\n')
    back = read(path, mapping=mapping)
    assert back.sensors == (Channel("b", "m/s²", -19.62, 9.81),)
    assert np.array_equal(back.outputs[0], -9.81 * record.outputs[0])
    assert back.provenance.parents == (record.hash,)
    with pytest.raises(InputError, match="was recorded at 100 Hz; it cannot be read at 50 Hz"):
        read(path, 50.0, mapping=mapping)
    with pytest.raises(InputError, match="leave inputs and outputs to it"):
        read(path, inputs="a", outputs="b", mapping=mapping)


BROKEN = """rate_hz = -3
crop_s = [2.0, 1.0]
units = "V"
[[inputs]]
column = true
name = 5
limits = [1.0]
[[inputs]]
column = "a"
scale = 0
offset = inf
gain = 2
"""


def test_every_mistake_with_its_line():
    with pytest.raises(MappingError) as caught:
        parse_mapping(BROKEN, "mapping 'm.toml'")
    print(caught.value)
    lines = [line for line, _ in caught.value.mistakes]
    assert lines == [1, 1, 2, 3, 5, 6, 7, 10, 11, 12]
    for words in (
        "'outputs' are missing",
        "'rate_hz' must be",
        "no key 'units'",
        "no key 'gain'",
        "two rising numbers",
    ):
        assert words in str(caught.value)


def test_mistakes_against_the_file(table):
    path, _ = table
    text = '[[inputs]]\ncolumn = "drivee"\n[[outputs]]\ncolumn = "2-3"\nname = "both"\n[[outputs]]\ncolumn = 9\n'
    with pytest.raises(MappingError) as caught:
        read(path, mapping=parse_mapping(text))
    print(caught.value)
    assert [line for line, _ in caught.value.mistakes] == [2, 4, 7]
    assert "has no column 'drivee'; it holds" in str(caught.value)
    with pytest.raises(InputError, match=r"no sample of 'run\.csv', 0\.04 s long, lies between 3 and 4 s"):
        read(path, mapping=parse_mapping('crop_s=[3,4]\n[[inputs]]\ncolumn="drive"\n[[outputs]]\ncolumn="left"\n'))


def test_mappings_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"absent\.toml' cannot be read \(no such file"):
        load_mapping(tmp_path / "absent.toml")
    with pytest.raises(MappingError, match="line 2: this is not TOML"):
        parse_mapping("rate_hz = 1\nx = = 2\n")


def test_the_mapping_of_the_documentation():
    text = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")
    mapping = parse_mapping(text.partition("```toml\n")[2].partition("```")[0])
    assert (mapping.rate_hz, mapping.crop_s) == (2500.0, (0.5, 4.5))
    assert [one.name for one in mapping.inputs] == ["motor current"]
