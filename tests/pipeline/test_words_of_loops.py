"""What became of a loop, in words: none is called known, quiet or a unit's that is not."""

import pytest

from ultraquiet.cli.study import _louder
from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop


class Loops:
    """Of a summary, its loops."""

    def __init__(self, **loops):
        self.closed_loop = {name: {"bench": loop, "flight": loop} for name, loop in loops.items()}


def settled(band_db):
    figures = {"lines": 5, "lines_missing": 0, "lines_hidden": "", "tones": {}, "mean_log_sensitivity_db": 0.0}
    bands = {"broadband_5_100_db": None, "broadband_10_60_db": None, "band_hz": (5.0, 50.0)}
    return StableLoop(
        status="ok: settled",
        growth_per_s=None,
        growth_hz=None,
        worst_direction_band_db=band_db,
        peak_amplification_db=9.0,
        **figures,
        **bands,
    )


@pytest.mark.parametrize(
    ("status", "unit", "said"),
    [
        ("unstable: it grows.", "bench", "calm is unstable on the bench"),
        ("unstable: it grows.", "flight", "calm is unstable on flight"),
        ("not known: 4 s do not tell.", "bench", "whether calm is stable on the bench is not known"),
    ],
)
def test_a_loop_that_did_not_settle(status, unit, said):
    assert UnstableLoop(status=status).on("calm", unit) == said


def test_a_law_that_is_ok_and_leaves_its_band_louder_is_said():
    assert _louder(Loops(calm=settled(3.0))) == []
    assert _louder(Loops(wild=UnstableLoop(status="unstable: it grows."))) == []
    (here, there) = _louder(Loops(soft=settled(-13.94)))
    assert here == ("soft is not quieter in every direction on the bench: over 5-50 Hz the worst is louder by 13.9 dB")
    assert "on flight: over" in there
