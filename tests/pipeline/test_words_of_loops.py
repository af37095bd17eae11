"""What became of a loop, in words: none is called known, quiet or a unit's that is not."""

import numpy as np
import pytest

from ultraquiet.bench import Wrapped
from ultraquiet.cli.study import _louder
from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop
from ultraquiet.simulate import Campaign
from ultraquiet.values import Channel, StateSpace


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
        ("not measured: Noise.", "bench", "calm settles on the bench, where noise hides how quiet it is"),
    ],
)
def test_a_loop_that_did_not_settle(status, unit, said):
    assert UnstableLoop(status=status).on("calm", unit) == said


def test_a_loop_of_which_noise_hides_everything_is_not_called_unstable(monkeypatch):
    """Two actuators that do nearly the same, heard through noise: the loop decays, its sensitivity is not heard."""
    plant = StateSpace(0.9 * np.eye(2), [[0.1, 0.1], [0.1, 0.1001]], np.eye(2), np.zeros((2, 2)), 1000.0)
    rng, x = np.random.default_rng(0), np.zeros(2)

    def step(u, d):
        y = x + 0.01 * rng.standard_normal(2)
        x[:] = plant.A @ x + plant.B @ (u + d)
        return y

    bench = Wrapped(step, lambda: None, 1000.0, ["a", "b"], [Channel("p", "um"), Channel("q", "um")])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), -0.01 * np.eye(2), 1000.0)
    monkeypatch.setattr("ultraquiet.simulate.campaigns.evaluation.drawn_bench", lambda bench, seed: bench)
    monkeypatch.setattr("ultraquiet.simulate.campaigns.evaluation.drawn_parameters", lambda bench: {})
    row = Campaign((("one", bench),), law, (5.0, 50.0), on="bench").evaluate(0)
    assert row["stable"]
    assert row["status"].startswith("not measured: The loop settles.")
    assert row["peak_db"] == np.inf


def test_a_law_that_is_ok_and_leaves_its_band_louder_is_said():
    assert _louder(Loops(calm=settled(3.0))) == []
    assert _louder(Loops(wild=UnstableLoop(status="unstable: it grows."))) == []
    (here, there) = _louder(Loops(soft=settled(-13.94)))
    assert here == ("soft is not quieter in every direction on the bench: over 5-50 Hz the worst is louder by 13.9 dB")
    assert "on flight: over" in there
