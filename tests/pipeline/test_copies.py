"""Records of files that a study names: copies of them in its folder, never in place of what was measured there."""

import numpy as np
import pytest
from test_kept_records import TwoMasses, state, take

import ultraquiet as uq
from ultraquiet.pipeline.store.copies import Copies
from ultraquiet.pipeline.store.recorded import finished_names


def record(level):
    return uq.Record(np.full((1, 5), level), np.zeros((1, 5)), rate_hz=10.0)


def test_copies_follow_the_files_and_are_written_once(tmp_path):
    for records in ({"a": record(1.0), "b": record(2.0)}, {"a": record(1.0), "b": record(3.0)}):
        copies = Copies(records, tmp_path)
        copies.claim()
        assert copies.take() == records
        assert {name: uq.files.load(tmp_path / "records" / f"{name}.h5").hash for name in records} == {
            name: each.hash for name, each in records.items()
        }
        assert finished_names(tmp_path) == ["a", "b"]
        before = {p: p.stat().st_mtime_ns for p in (tmp_path / "records").iterdir()}
        copies.claim()
        copies.take()
        assert {p: p.stat().st_mtime_ns for p in before} == before


def test_what_was_measured_and_what_was_copied_do_not_mix(tmp_path):
    measured, copied = tmp_path / "measured", tmp_path / "copied"
    take(measured, TwoMasses())
    before = state(measured)
    with pytest.raises(uq.errors.StorageError, match="were measured there"):
        Copies({"push": record(1.0)}, measured).claim()
    assert state(measured) == before
    copied.mkdir()
    copies = Copies({"push": record(1.0)}, copied)
    copies.claim()
    copies.take()
    before = state(copied)
    with pytest.raises(uq.errors.StorageError, match="--record-again"):
        take(copied, TwoMasses())
    assert state(copied) == before
