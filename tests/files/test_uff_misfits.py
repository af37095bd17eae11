"""Universal files whose parts do not agree, with each other or with what they say of themselves: one sentence each."""

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet._base.errors import UltraquietError
from ultraquiet.values import Record

RATE, POINTS = 1000.0, 50


@pytest.fixture
def written(tmp_path, rng):
    """Write a file of others, one data set 58 for each (points, step, start)."""
    import pyuff

    def write(*sets):
        path = tmp_path / "others.uff"
        path.unlink(missing_ok=True)
        for k, (points, step_s, start_s) in enumerate(sets):
            told = {
                "type": 58,
                "binary": 0,
                "func_type": 1,
                "rsp_node": k + 1,
                "rsp_dir": 3,
                "ref_node": 0,
                "ref_dir": 0,
            }
            axes = {"abscissa_spacing": 1, "orddenom_spec_data_type": 0, "abscissa_spec_data_type": 17}
            data = {"x": start_s + np.arange(points) * step_s, "data": rng.standard_normal(points)}
            pyuff.UFF(str(path)).write_sets({**told, **axes, **data}, mode="add")
        return path

    return write


def refusal(path, **choice):
    with pytest.raises(UltraquietError) as caught:
        files.read_record(path, **choice)
    print(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


PAIR = {"inputs": "1", "outputs": "2"}
EVEN = (POINTS, 1 / RATE, 0.0)


def test_channels_that_do_not_fit_together(written):
    assert files.read_record(written(EVEN, EVEN), **PAIR).rate_hz == RATE
    assert "differ in length: 1 +Z (50), 2 +Z (40)" in refusal(written(EVEN, (40, 1 / RATE, 0.0)), **PAIR)
    assert "differ in rate: 1 +Z (1000 Hz), 2 +Z (500 Hz)" in refusal(written(EVEN, (POINTS, 2 / RATE, 0.0)), **PAIR)
    assert "do not start together: 1 +Z (0 s), 2 +Z (0.5 s)" in refusal(written(EVEN, (POINTS, 1 / RATE, 0.5)), **PAIR)


@pytest.mark.parametrize("said", [0, 40, 49, 51, 60, 10_000, -5])
def test_a_head_that_counts_other_points_than_there_are(written, said):
    path = written(EVEN, EVEN)
    path.write_text(path.read_text().replace(f"{POINTS:10}", f"{said:10}", 1))
    assert f"data set 1 of 'others.uff' holds {POINTS} of {said} values" in refusal(path, **PAIR)


def test_a_step_of_nothing_is_no_rate(written):
    path = written(EVEN, EVEN)
    path.write_text(path.read_text().replace("1.00000e-03", "0.00000e+00"))
    assert "states no sampling rate" in refusal(path, **PAIR)
    assert files.read_record(path, rate_hz=RATE, **PAIR).rate_hz == RATE


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("rate_hz", [3500.0, 1 / 3, 44100.0, 1e6 / 7])
def test_a_rate_in_our_own_words_that_the_step_belies(tmp_path, rng, text, rate_hz):
    """The rate stands in an ID line to the last bit and, to six digits, in the step: either may have been changed."""
    record = Record(rng.standard_normal((1, POINTS)), rng.standard_normal((2, POINTS)), rate_hz)
    path = files.export_record(record, tmp_path / "ours.uff", text=text)
    assert files.read_record(path).rate_hz == rate_hz
    whole = path.read_bytes()
    path.write_bytes(whole.replace(f"{rate_hz!r} Hz".encode(), b"1234.0 Hz"))
    assert "one of them is wrong" in refusal(path)
    path.write_bytes(whole.replace(b"output 2 of 2", b"output 2 of 3").replace(b"output 1 of 2", b"output 1 of 3"))
    assert "should hold 3 channels of output" in refusal(path)
