"""What became of a loop, in words: none is called known, quiet or a unit's that is not."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.bench import LinearBench, Wrapped
from ultraquiet.cli.study import _louder
from ultraquiet.pipeline.control import OpenLoops, _closed_on, closed
from ultraquiet.pipeline.facts.loops import LoopFacts, StableLoop, UnstableLoop
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.simulate import Campaign, LoopCheck, OpenLoop
from ultraquiet.values import Channel, StateSpace, Status, StatusWord


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
    ("status", "unit", "said", "stable"),
    [
        ("unstable: it grows.", "bench", "calm is unstable on the bench", False),
        ("unstable: it grows.", "flight", "calm is unstable on flight", False),
        ("not known: 4 s do not tell.", "bench", "whether calm is stable on the bench is not known", None),
        ("not measured: Noise.", "bench", "calm settles on the bench, where noise hides how quiet it is", None),
    ],
)
def test_a_loop_that_was_not_measured(status, unit, said, stable):
    """Only one that ran away is called unstable in the summary, whatever a stage of an older version wrote."""
    loop = UnstableLoop(status=status)
    assert loop.on("calm", unit) == said
    assert loop.stable is stable
    older = {"units": {unit: to_plain(loop) | {"stable": False}}}
    again = from_plain(LoopFacts, older).units[unit]
    assert type(again) is UnstableLoop
    assert again.stable is stable
    assert to_plain(again) == to_plain(loop)


def test_levels_at_a_tone_have_the_units_of_their_channels():
    """A bench in newtons and nanometres: nothing of it is in volts, and no paper counts it."""
    force, place = Channel("push", "N"), Channel("mass", "nm")
    plant = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1000.0, actuators=[force], sensors=[place])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.2]], 1000.0)
    plan = LoopPlan(("bench",), (50.0,), 2.0, 1.0, (20.0, 100.0))
    found = closed("calm", law, OpenLoops(LinearBench(plant), plan)).facts.units["bench"]
    tone = found.tones["50"]
    levels = tone.levels
    assert (levels.units, levels.command_units, levels.command) == (("nm",), ("N",), 2.0)
    assert levels.below_command_db == pytest.approx(-20 * np.log10(levels.closed / 2.0))
    assert 20 * np.log10(levels.open / levels.closed) == pytest.approx(tone.reduction_db_per_channel)
    for new, old in (("open", "open_v"), ("closed", "closed_v"), ("floor", "floor_v")):
        np.testing.assert_array_equal(getattr(levels, new), getattr(tone, old))


@pytest.mark.slow
def test_a_loop_of_which_noise_hides_everything_is_not_called_unstable(monkeypatch):
    """Two actuators that do nearly the same, heard through noise: the loop decays, its sensitivity is not heard."""
    plant = StateSpace(0.9 * np.eye(2), [[0.1, 0.1], [0.1, 0.1001]], np.eye(2), np.zeros((2, 2)), 1000.0)
    rng, x, (A, B) = np.random.default_rng(0), [0.0, 0.0], (plant.A.tolist(), plant.B.tolist())

    def step(u, d):  # in numbers of Python: arrays of two take five times as long
        y = [each + 0.01 * rng.standard_normal() for each in x]
        v, w = (float(each) for each in u + d)
        x[:] = (a[k] * x[k] + b[0] * v + b[1] * w for k, (a, b) in enumerate(zip(A, B, strict=True)))
        return y

    bench = Wrapped(step, lambda: None, 1000.0, ["a", "b"], [Channel("p", "um"), Channel("q", "um")])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), -0.01 * np.eye(2), 1000.0)
    monkeypatch.setattr("ultraquiet.simulate.campaigns.evaluation.drawn_bench", lambda bench, seed: bench)
    monkeypatch.setattr("ultraquiet.simulate.campaigns.evaluation.drawn_parameters", lambda bench: {})
    row = Campaign((("one", bench),), law, (5.0, 50.0), on="bench").evaluate(0)
    assert row["stable"]
    assert row["status"].startswith("not measured: The loop settles.")
    assert row["peak_db"] == np.inf


def static(nu, ny, gain):
    """A law u = K y of the first channels of each side."""
    return StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), gain * np.eye(nu, ny), 1000.0)


def loud(tone_hz, amplitude, duration_s):
    return LoopPlan(("bench",), (50.0, tone_hz), amplitude, duration_s, (5.0, 20.0))


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
def test_a_run_too_short_for_its_tone_is_no_verdict_on_the_law(ny, nu):
    units = [Channel(f"push {k}", "kN") for k in range(nu)], [Channel(f"place {k}", "um") for k in range(ny)]
    plant = StateSpace(0.5 * np.eye(ny), np.eye(ny, nu), np.eye(ny), np.zeros((ny, nu)), 1000.0, *units)
    with pytest.raises(InputError, match=r"'tones_hz' must lie between 1\.33333 and 500 Hz, got 1") as refused:
        closed("calm", static(nu, ny, -0.2), OpenLoops(LinearBench(plant), loud(1.0, 0.5, 1.5)))
    assert refused.value.of_question


@pytest.mark.parametrize("breaks_open", [False, True], ids=["with the law", "without it"])
def test_only_what_a_loop_does_is_a_verdict_on_its_law(breaks_open, monkeypatch):
    """A place that answers by no number beyond a reach, once a law pushes; or, another bench, while none does."""
    x = np.zeros(1)

    def step(u, d):
        y = x.copy()
        x[:] = 0.5 * x + u + d
        return y if abs(y[0]) < 1e4 or breaks_open == bool(u[0]) else [np.inf]

    bench = Wrapped(step, lambda: x.fill(0.0), 1000.0, [Channel("push", "N")], [Channel("place", "um")])
    calm = LoopCheck(Status(StatusWord.OK, "It settles."), np.ones(1), np.ones(1), -700.0, 1.0, 0.0, 1.0)
    monkeypatch.setattr("ultraquiet.simulate.check_stability", lambda *_: calm)
    one = static(1, 1, -0.2), OpenLoop(bench), loud(20.0, 3e4, 0.2), None
    if breaks_open:
        with pytest.raises(InputError, match="1 finite reading") as refused:
            _closed_on(*one)
        assert refused.value.of_question
        return
    found, _ = _closed_on(*one)
    print(found.status)
    assert found.status.startswith("unstable: Under disturbances the loop ran away: Wrapped")
    assert LoopFacts(units={"bench": found}).unbearable


def test_a_law_that_is_ok_and_leaves_its_band_louder_is_said():
    assert _louder(Loops(calm=settled(3.0))) == []
    assert _louder(Loops(wild=UnstableLoop(status="unstable: it grows."))) == []
    (here, there) = _louder(Loops(soft=settled(-13.94)))
    assert here == ("soft is not quieter in every direction on the bench: over 5-50 Hz the worst is louder by 13.9 dB")
    assert "on flight: over" in there
