"""A record on disk picks channels and stretches as one in memory does, and refuses the same."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.files import LongRecord, LongWriter

NAN = float("nan")
SAMPLES = 1000


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """The same record on disk and in memory."""
    rng = np.random.default_rng(1)
    u, y = (rng.standard_normal((rows, SAMPLES)).astype(np.float32) for rows in (2, 3))  # as a file keeps them
    record = uq.Record(u, y, 500.0, ["x", "y"], ["a", "b", "c"])
    path = tmp_path_factory.mktemp("long") / "record.h5"
    with LongWriter(path, record.rate_hz, record.actuators, record.sensors) as file:
        file.append(record.inputs, record.outputs)
    return LongRecord(path), record


@pytest.mark.parametrize("chosen", [[0], [-1], ["y", "x"], [1, 0], "y", 0, (np.int64(1),), None])
def test_channels_are_picked_as_of_a_record_in_memory(pair, chosen):
    long, record = (each.pick(inputs=chosen, outputs=["c", 0]) for each in pair)
    whole = long.part()
    np.testing.assert_array_equal(whole.inputs, record.inputs)
    np.testing.assert_array_equal(whole.outputs, record.outputs)
    assert (long.actuators, long.sensors) == (record.actuators, record.sensors)


@pytest.mark.parametrize("chosen", [[5], [-4], ["roof"], "roof", 7, [0.0], [True], [NAN], [None], []], ids=repr)
@pytest.mark.parametrize("side", ["inputs", "outputs"])
def test_channels_that_are_none_are_refused(pair, side, chosen):
    for each in pair:
        with pytest.raises(InputError, match=r"there is no|at least one channel|hold no samples") as refused:
            each.pick(**{side: chosen})
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("span", [(0, 5), (3, None), (None, 7), (-5, None), (2, -2), (0, 10**9), (np.int64(2), 9)])
def test_a_part_is_that_of_a_record_in_memory(pair, span):
    long, record = (each.part(*span) for each in pair)
    np.testing.assert_array_equal(long.inputs, record.inputs)
    np.testing.assert_array_equal(long.outputs, record.outputs)
    read = pair[0].read(*span)
    blocks = list(pair[0].blocks(3, *span)) if span[0] is not None else [read]
    for found in (read, (np.hstack([u for u, _ in blocks]), np.hstack([y for _, y in blocks]))):
        np.testing.assert_array_equal(found[1], record.outputs)


@pytest.mark.parametrize(
    "span",
    [(10, 5), (5, 5), (-5, 10), (2000, 3000), (NAN, 5), (0, NAN), (0.0, 5), (0, 5.0), ("a", 5), (True, 5), ([], 5)],
    ids=repr,
)
def test_a_stretch_without_samples_or_of_no_whole_numbers_is_refused(pair, span):
    long, record = pair
    for verb in (long.part, long.read, lambda *at: list(long.blocks(3, *at)), record.part):
        with pytest.raises(InputError, match=r"must be a whole number|no samples") as refused:
            verb(*span)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "given", [{"path": None}, {"path": 3}, {"inputs": None}, {"outputs": 3}, {"rate_hz": "fast"}, {"rate_hz": NAN}]
)
def test_a_long_record_of_arguments_of_another_kind_is_refused(pair, given):
    ((name, _),) = given.items()
    with pytest.raises(InputError, match=f"^LongRecord: '{name}' must be"):
        LongRecord(**{"path": pair[0].path, **given})


@pytest.mark.parametrize(("channels", "samples"), [((5, 5), 4), ((4, 3), 2), ((1, 1), 1), ((3, 5), 5), ((3, 5), 4)])
def test_fewer_samples_than_channels_are_read_as_they_were_written(tmp_path, rng, channels, samples):
    record = uq.Record(rng.standard_normal((channels[0], samples)), rng.standard_normal((channels[1], samples)), 500.0)
    with LongWriter(tmp_path / "few.h5", 500.0, *channels, precision="float64") as file:
        for k in range(samples):
            file.append(record.inputs[:, k : k + 1], record.outputs[:, k : k + 1])
    long = LongRecord(tmp_path / "few.h5")
    assert (long.samples, len(long.actuators), len(long.sensors)) == (samples, *channels)
    assert long.part().hash == record.hash
    assert np.array_equal(long.pick(outputs=[-1]).part().outputs, record.outputs[-1:])


def test_a_channel_may_stand_by_itself_and_what_is_refused_leaves_nothing(tmp_path):
    with LongWriter(tmp_path / "run.h5", 500.0, "force", uq.Channel("speed", "m/s")) as file:
        file.append(np.ones((1, 9)), np.ones((1, 9)))
    long = LongRecord(tmp_path / "run.h5")
    assert [c.label for c in (*long.actuators, *long.sensors)] == ["force", "speed (m/s)"]
    before = list(tmp_path.iterdir())
    for words, given in (
        ("'rate_hz' must be above zero", {"rate_hz": 0.0}),
        ("'rate_hz' must be a number", {"rate_hz": "fast"}),
        ("'inputs' must be at least 1", {"inputs": 0}),
        ("'inputs' must be a whole number", {"inputs": 1.5}),
        ("'outputs' must name at least one channel", {"outputs": []}),
    ):
        with pytest.raises(InputError, match=f"^LongWriter: {words}"):
            LongWriter(**{"path": tmp_path / "run.h5", "rate_hz": 500.0, "inputs": 1, "outputs": 1, **given})
        assert list(tmp_path.iterdir()) == before
