"""A law comes on in steps: margins measured without a model are those of algebra, and no unstable gain ever runs."""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import BenchError, InputError, InterlockError
from ultraquiet.analyse import disk_margin, peak_sensitivity
from ultraquiet.bench import LinearBench, Wrapped
from ultraquiet.pipeline.facts.mission import CommissioningFacts
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.mission.commission import commissioned
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.report import mission as report
from ultraquiet.pipeline.tables.mission import CommissionTable
from ultraquiet.simulate import commission
from ultraquiet.simulate.commissioning.commission import replace_gain
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values import Channel, StateSpace, SteppedController
from ultraquiet.values.interconnect import feedback, gain

RATE_HZ = 200.0
BAND_HZ = (2.0, 10.0)
HOW = {"seconds": 2.0, "settle_s": 1.0}


def plant(ny=2, nu=2, gain=1.0, reach=np.inf):
    """Masses on springs with a sample of delay; forces in, velocities out."""
    one = np.array([[0.98, 0.19], [-0.19, 0.98]]) * 0.98
    n = max(ny, nu)
    A = np.kron(np.eye(n), one)
    B = np.kron(np.eye(n)[:, :nu] + 0.1, [[0.0], [0.1]])
    C = gain * np.kron(np.eye(n)[:ny] + 0.05, [[0.2, 1.0]])
    sensors = [Channel(f"y{k}", "m", -reach, reach) for k in range(ny)]
    return StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ, [Channel(f"u{k}", "N") for k in range(nu)], sensors)


def law(ny=2, nu=2, gain=1.0, size=-2.0):
    K = size / gain * np.eye(nu, ny)
    return StateSpace(0.5 * np.eye(ny), 0.5 * np.eye(ny), K, np.zeros((nu, ny)), RATE_HZ)


SHAPES = [(1, 1, 1.0), (2, 2, 1e9), (2, 2, 1e-9), (3, 2, 1.0), (2, 3, 1.0)]


@pytest.mark.gate("1-1-1.0")
@pytest.mark.parametrize(("ny", "nu", "gain"), SHAPES)
def test_margins_are_those_of_algebra(ny, nu, gain):
    G, K = plant(ny, nu, gain), law(ny, nu, gain)
    assert feedback(G, K).is_stable()
    found = commission(LinearBench(G), K, BAND_HZ, **HOW)
    print(found.status, [step.disk for step in found.steps])
    assert found.status.ok
    assert [step.gain for step in found.steps] == [0.1, 0.3, 1.0]
    for step in found.steps:
        part = replace_gain(K, step.gain)
        for end in ("input", "output"):
            # lines stand 1/16 of an octave apart, so the least margin between them may be a little less
            true = disk_margin(G, part, end)
            assert true - 1e-6 <= step.disk[end] <= 1.06 * true
        assert step.peak_db["output"] == pytest.approx(max(peak_sensitivity(G, part)[0], 0.0), abs=0.5)


@pytest.mark.slow
def test_a_stepped_law_is_measured_by_its_commands():
    G, K = plant(), law()
    known = commission(LinearBench(G), K, BAND_HZ, **HOW)

    class Untold:
        rate_hz = RATE_HZ

        def __init__(self):
            self._inner = SteppedController(K)

        def reset(self):
            self._inner.reset()

        def step(self, y):
            return self._inner.step(y)

    found = commission(LinearBench(G), Untold(), BAND_HZ, gains=(0.1, 1.0), **HOW)
    for end in ("input", "output"):
        assert found.steps[-1].disk[end] == pytest.approx(known.steps[-1].disk[end], rel=1e-3)


def test_a_law_that_is_unstable_at_its_gain_never_runs_there():
    G, loud = plant(), law(size=-60.0)
    assert not feedback(G, loud).is_stable()
    ran = []

    class Watched(LinearBench):
        def stream(self, actuation, disturbance=None, controller=None, **how):
            if controller is not None:
                ran.append(feedback(G, controller).is_stable())
            return super().stream(actuation, disturbance, controller, **how)

    found = commission(Watched(G), loud, BAND_HZ, gains=(0.01, 0.1, 0.3, 1.0), **HOW)
    print(found.status)
    assert found.status.word == "fragile"
    assert "would keep a disk margin of" in found.status.sentence
    assert ran
    assert all(ran)
    assert found.gain < 1.0


def test_a_margin_that_is_not_kept_is_said_and_the_law_taken_off():
    found = commission(LinearBench(plant()), law(), BAND_HZ, margin=1.9, **HOW)
    assert found.status.word == "fragile"
    assert found.gain == 0.1
    assert "1.9 was asked" in found.status.sentence


def test_a_reading_at_its_limit_ends_the_run_with_a_ramp():
    """At once to a gain that is unstable: readings grow to their limit and the run is faded out."""
    G = plant(reach=50.0)
    blocks = []

    class Watched(LinearBench):
        def stream(self, actuation, disturbance=None, controller=None, **how):
            for block in super().stream(actuation, disturbance, controller, **how):
                if controller is not None:
                    blocks.append(block)
                yield block

    found = commission(Watched(G), law(size=-60.0), BAND_HZ, gains=(1.0,), ramp_s=0.1, **HOW)
    print(found.status)
    assert found.status.word == "unstable"
    assert found.gain == 0.0
    sent = np.concatenate([block.command for block in blocks], axis=1)
    assert sent.shape[1] < 0.9 * (HOW["settle_s"] + 2 * HOW["seconds"]) * RATE_HZ
    assert np.abs(sent[:, -1]).max() < 0.1 * np.abs(sent).max()


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_commands_at_their_limits_are_no_quiet_loop(ny, nu, unit):
    """A loop that swings between the limits of its commands hardly answers an injection: it looks like none at all."""
    B = np.eye(ny, nu)
    B[:, ny:] = 0.3
    wires = [Channel(f"u{k}", "N", -1.0, 1.0) for k in range(nu)], [Channel(f"y{k}", "nm") for k in range(ny)]
    G = StateSpace(0.9 * np.eye(ny), B, unit * np.eye(ny), np.zeros((ny, nu)), RATE_HZ, *wires)
    K = gain(-2.5 / unit * np.eye(nu, ny), RATE_HZ)
    assert not feedback(G, K).is_stable()
    found = commission(LinearBench(G), K, (1.0, 10.0), gains=(1.0,), **HOW)
    print(found.status)
    assert found.status.word == "unstable"
    assert "the command of 'u0' met its limit" in found.status.sentence


def test_no_step_passes_the_verge_of_instability():
    """Unstable from 13 % of the gain on, calm to look at from 18 % on: the next step is foreseen from 10 %."""
    K = gain([[-14.4]], 100.0)
    G = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], 100.0, [Channel("push", "N", -1.0, 1.0)], ["position"])
    found = commission(LinearBench(G), K, BAND_HZ, gains=(0.1, 1.0), **HOW)
    print(found.status, found.steps[0].next_disk, found.steps[0].next_gain)
    assert found.status.word == "fragile"
    assert found.gain == 0.1
    assert found.steps[0].next_disk < 0.1
    assert found.steps[0].next_gain == pytest.approx(1.9 / 14.4, rel=0.01)


def test_a_mode_that_grows_between_the_lines_is_heard_at_the_end():
    def block(f_hz, damping):
        p = np.exp(2 * np.pi * f_hz / 1000.0 * complex(-damping, np.sqrt(1 - damping**2)))
        return np.array([[p.real, p.imag], [-p.imag, p.real]])

    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = block(10.0, 0.05), block(203.0, 5e-4)
    G = StateSpace(A, [[0.0], [0.05], [0.0], [0.01]], [[1.0, 0.0, 1.0, 0.0]], [[0.0]], 1000.0)
    K = StateSpace([[0.0]], [[1.0]], [[-0.3]], [[0.0]], 1000.0)
    assert not feedback(G, K).is_stable()
    found = commission(LinearBench(G), K, (5.0, 30.0))
    print(found.status)
    assert found.status.word == "unstable"
    assert found.gain == 0.3
    assert "202.8 Hz" in found.status.sentence


def test_a_bench_that_fails_is_no_verdict_on_the_law():
    calls = []

    def step(u, d):
        calls.append(u)
        if len(calls) > 2500:
            raise BenchError("Rig: the cable was pulled.")
        return u

    bench = Wrapped(step, lambda: None, RATE_HZ, ["force"], ["y"])
    with pytest.raises(BenchError, match="the cable was pulled"):
        commission(bench, law(1, 1, size=-0.1), BAND_HZ, **HOW)


def test_what_cannot_be_commissioned_is_said():
    with pytest.raises(InputError, match="'gains' must rise"):
        commission(LinearBench(plant()), law(), BAND_HZ, gains=(0.3, 0.1))
    with pytest.raises(InputError, match="'margin' must lie"):
        commission(LinearBench(plant()), law(), BAND_HZ, margin=3.0)
    with pytest.raises(InputError, match="moves no sensor"):
        commission(LinearBench(plant(gain=0.0)), law(), BAND_HZ, **HOW)
    with pytest.raises(InputError, match="must take 2 readings"):
        commission(LinearBench(plant()), law(3, 2), BAND_HZ, **HOW)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_the_hexapod_with_hysteresis_noise_and_drift(unit):
    """The law is designed from the ground unit's model and flown unchanged; then the same at 2.5 times its gain."""
    model = uq.bench.Hexapod(unit="ground").linear_model()
    K = uq.design.BandAttenuation(band_hz=(9.0, 108.0), height=12.0, structure="repeated").design(model).controller
    bench = uq.bench.Hexapod(unit=unit, seed=3, hysteresis=True, drift=1.0)
    found = commission(bench, K, (10.0, 100.0))
    print(found.status)
    for step in found.steps:
        print(
            f"{step.gain:.0%}: {step.disk} at {step.disk_hz} Hz, peak {step.peak_db}, reduction {step.reduction_db:.1f}"
        )
    assert found.status.ok
    true = disk_margin(bench.linear_model(), K)
    assert found.steps[-1].disk["output"] == pytest.approx(true, rel=0.2)
    loud = commission(bench, replace_gain(K, 2.5), (10.0, 100.0))
    print(loud.status)
    assert loud.status.word == "fragile"
    assert loud.gain <= 0.3


def test_a_damped_plant_of_another_kind(seed):
    G = damped_plant(seed, channels=1)
    K = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.01]], G.rate_hz)
    found = commission(LinearBench(G), K, (10.0, 60.0), gains=(1.0,), seconds=1.0, settle_s=1.0)
    assert found.steps[0].disk["output"] == pytest.approx(found.steps[0].disk["input"], rel=1e-6)


def test_a_study_puts_its_law_on_and_tells_every_step():
    plan = LoopPlan(("bench",), (), 1.0, 2.0, BAND_HZ)
    table = CommissionTable(gains=[0.1, 1.0], seconds=2.0, settle_s=1.0)
    facts = commissioned("calm", law(1, 1), LinearBench(plant(1, 1)), plan, table).facts
    assert from_plain(CommissioningFacts, json.loads(json.dumps(to_plain(facts)))).units["bench"].ok
    assert [step.gain for step in facts.units["bench"].steps] == [0.1, 1.0]
    section = report.commissioning(facts)
    assert len(section.tables[0].rows) == 2
    assert "The law runs at 100% of its gain" in " ".join(section.paragraphs)
    refused = commissioned("calm", law(1, 1), LinearBench(plant(1, 1, gain=0.0)), plan, table).facts.units["bench"]
    assert not refused.ok
    assert "moves no sensor" in refused.status


@dataclass(frozen=True)
class Rigs:
    """Benches behind one card; what ends the first run of a law on one of them is raised in the middle of it."""

    error: Exception
    unit: str = "first"
    shape: tuple[int, int] = (1, 1)
    moved: list[str] = field(default_factory=list)
    rate_hz: float = RATE_HZ

    @property
    def actuators(self):
        return plant(*self.shape, reach=1e6).actuators

    @property
    def sensors(self):
        return plant(*self.shape, reach=1e6).sensors

    def run(self, actuation, disturbance=None, controller=None):
        self.moved.append(self.unit)
        if controller is not None:
            raise self.error
        return LinearBench(plant(*self.shape, reach=1e6)).run(actuation, disturbance)


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (3, 4), (5, 3)])
def test_a_bench_that_is_stopped_by_hand_ends_the_stage_and_moves_no_further_unit(ny, nu):
    """What a law makes of its loop is told of each unit; an emergency stop is no verdict, and nothing goes on."""
    plan = LoopPlan(("first", "second"), (), 1.0, 2.0, BAND_HZ)
    table = CommissionTable(gains=[0.1, 1.0], seconds=2.0, settle_s=1.0)
    by_hand = Rigs(InterlockError("Rig: the emergency stop was pressed.", "stop", 40, 1.0), shape=(ny, nu))
    with pytest.raises(InterlockError, match="the emergency stop was pressed"):
        commissioned("calm", law(ny, nu), by_hand, plan, table)
    assert set(by_hand.moved) == {"first"}
    by_level = Rigs(InterlockError("Rig: a reading was too large.", "reading", 40, 9.0), shape=(ny, nu))
    units = commissioned("calm", law(ny, nu), by_level, plan, table).facts.units
    assert all("a reading was too large" in unit.status for unit in units.values())
    assert set(by_level.moved) == {"first", "second"}


@pytest.mark.parametrize(("size", "said"), [(-30.0, "finite commands"), (0.9, "readings were no longer finite")])
def test_a_loop_without_limits_that_runs_away_is_unstable(size, said):
    """Nothing ends it but the range of numbers, of what is commanded or of what is read, whichever ends first."""
    G = StateSpace([[0.9]], [[10.0]], [[1.0]], [[0.0]], RATE_HZ)
    found = commission(LinearBench(G), gain([[size]], RATE_HZ), BAND_HZ, gains=(1.0,), **HOW)
    print(found.status)
    assert found.status.word == "unstable"
    assert said in found.status.sentence
