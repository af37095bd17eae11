"""Units that differ, temperature that drifts, and campaigns over seeds."""

import pickle
from dataclasses import asdict, replace

import numpy as np
import pytest

from ultraquiet import StateSpace
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.symmetry import reciprocity_error, threefold_error
from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.physics import drift, spread
from ultraquiet.bench.hexapod.physics.drift import CYCLES, REFERENCE_C, at_temperature, weather
from ultraquiet.bench.hexapod.physics.parts import nominal
from ultraquiet.values import SteppedController

RATE = 3500.0
BAND = np.geomspace(5.0, 250.0, 60)


def numbers(parts):
    """Every number of the parts, by name."""
    found = {}

    def walk(name, value):
        if isinstance(value, dict):
            for key, held in value.items():
                walk(f"{name}.{key}", held)
        elif isinstance(value, tuple | list):
            for i, held in enumerate(value):
                walk(f"{name}.{i}", held)
        elif isinstance(value, np.ndarray):
            walk(name, value.tolist())
        elif value is not None:
            found[name] = float(value)

    walk("", asdict(parts))
    return found


@pytest.mark.parametrize("unit", ["ground", "flight", "rigid"])
def test_every_number_is_drawn_within_its_tolerance(unit, seed):
    drawing = numbers(nominal(unit, "all"))
    shares = {**spread.STRUT_SHARES, **spread.LINE_SHARES, **spread.MOUNT_SHARES}
    shares |= {k: max(v, shares.get(k, 0)) for k, v in spread.PROOF_MASS_SHARES.items()}
    shares |= {"mass_kg": spread.MASS_SHARE, "inertia_kg_m2": spread.INERTIA_SHARE}
    moved, largest = set(), {}
    for k in range(30):
        drawn = numbers(spread.draw(nominal(unit, "all"), 1.0, seed + k))
        assert drawn.keys() == drawing.keys()
        for name, value in drawn.items():
            key = next((part for part in name.split(".") if part in shares), None)
            allowed = shares[key] * drawing[name] if key else 0.0
            if ".at.base" in name or ".at.platform" in name:
                allowed = spread.JOINT_M
            if "aside_m" in name:
                allowed = spread.CENTRE_M
            off = abs(value - drawing[name])
            assert off <= allowed * (1 + 1e-12), name
            if off:
                moved.add(name)
            if allowed:
                largest[name] = max(largest.get(name, 0.0), off / allowed)
    print(f"{unit}: {len(moved)} of {len(drawing)} numbers vary; {min(largest.values()):.2f} of the tolerance used")
    # Thirty even draws leave the outer half of an interval empty once in 1e9 times.
    kept = {name for name, at in largest.items() if not drawing[name] and "aside" not in name}
    assert min(v for k, v in largest.items() if k not in kept) > 0.5


def test_units_repeat_by_seed_and_grow_with_spread(seed):
    flight = {"unit": "flight", "unit_seed": seed}
    g = {s: Hexapod(**flight, spread=s).linear_response(BAND) for s in (0.0, 0.1, 1.0)}
    off = {s: (np.abs(v - g[0.0]).max() / np.abs(g[0.0]).max()) for s, v in g.items()}
    print({s: f"{v:.1e}" for s, v in off.items()})
    assert off[0.0] == 0.0 < off[0.1] < off[1.0]
    again = Hexapod(**flight, spread=1.0).linear_response(BAND)
    assert np.array_equal(again, g[1.0])
    other = Hexapod(unit="flight", unit_seed=seed + 1, spread=1.0).linear_response(BAND)
    assert not np.allclose(other, g[1.0], rtol=1e-3)


def test_spread_breaks_the_symmetries_that_the_drawing_has(seed):
    for s, exact in ((0.0, True), (1.0, False)):
        g = Hexapod(unit="rigid", spread=s, unit_seed=seed).linear_response(BAND)
        threefold, reciprocal = threefold_error(g).max(), reciprocity_error(g).max()
        print(f"spread {s:g}: threefold to {threefold:.1e}, reciprocity to {reciprocal:.1e}")
        assert (threefold < 1e-10) == exact
        assert (reciprocal < 1e-10) == exact


def test_units_stay_stable_and_near_each_other(seed):
    """Thirty units: all stable, suspension modes within an eighth of the drawing's."""
    drawn, furthest = Hexapod(unit="flight").model.mechanics.modes()[0][:6], 0.0
    for k in range(30):
        bench = Hexapod(unit="flight", spread=1.0, unit_seed=seed + k)
        assert bench.linear_model().is_stable()
        furthest = max(furthest, np.abs(bench.model.mechanics.modes()[0][:6] / drawn - 1.0).max())
    print(f"suspension modes at most {100 * furthest:.1f} % from the drawing's")
    assert 0.01 < furthest < 0.125


def test_temperature_moves_as_stated(seed):
    for unit, cycles in CYCLES.items():
        t = np.linspace(0.0, 2 * 86400.0, 4001)
        celsius = np.array([weather(unit, seed, 1.0)(at) for at in t])
        reach = sum(kelvin for _, kelvin in cycles)
        print(f"{unit}: {celsius.min():.2f} to {celsius.max():.2f} degrees")
        assert np.abs(celsius - REFERENCE_C).max() <= reach
        assert np.ptp(celsius) > 1.8 * reach
        twice = np.array([weather(unit, seed, 2.0)(at) for at in t[:50]]) - REFERENCE_C
        assert twice == pytest.approx(2 * (celsius[:50] - REFERENCE_C))
        step = np.abs(weather(unit, seed, 1.0)(1.0) - weather(unit, seed, 1.0)(0.0))
        assert step < 6e-3


def test_the_thermometer_follows_the_runs(seed):
    quiet = np.zeros((6, 7000))
    bench = Hexapod(unit="flight", seed=seed, drift=1.0)
    told = weather("flight", seed, 1.0)
    assert bench.temperature_c == told(0.0)
    bench.run(quiet, run_index=3)
    assert bench.run(quiet, run_index=3).provenance.settings["temperature_c"] == told(180.0)
    assert told(180.0) != bench.temperature_c == pytest.approx(told(182.0), abs=0.01)
    assert Hexapod(unit="flight", seed=seed).temperature_c == REFERENCE_C
    assert Hexapod(unit="flight", seed=seed, drift=1.0, linear=True).temperature_c == REFERENCE_C
    assert pickle.loads(pickle.dumps(bench)).temperature_c == bench.temperature_c


def test_warmth_softens_the_stages_and_lengthens_the_strokes():
    parts = nominal("ground", "all")
    warm = at_temperature(parts, REFERENCE_C + 4.0)
    for name, share in drift.PER_KELVIN_STRUT.items():
        assert warm.per_strut(name) == pytest.approx(parts.per_strut(name) * (1 + 4 * share))
    for name, share in drift.PER_KELVIN_LINE.items():
        assert warm.per_line(name) == pytest.approx(parts.per_line(name) * (1 + 4 * share))
    assert warm.payload == parts.payload


def test_the_warm_state_space_agrees_with_the_frequency_domain(seed):
    """The states are told in the shapes of the drawing's temperature, which are no longer the modes."""
    bench, f_hz = Hexapod(unit="flight", instruments="all", spread=1.0, unit_seed=seed), np.geomspace(1.0, 1500.0, 80)
    model, truth = bench.linear_model(28.0).frequency_response(f_hz), bench.linear_response(f_hz, 28.0)
    off = np.abs(20 * np.log10(np.abs(model / truth))).max()
    moved = np.abs(20 * np.log10(np.abs(bench.linear_response(f_hz) / truth))).max()
    print(f"at 28 degrees: {off:.1e} dB between both routes, {moved:.1f} dB from 20 degrees")
    assert off < 0.1 < moved


def test_a_drifting_run_is_the_same_in_any_blocks_and_differs_from_a_steady_one(rng, seed):
    u = 10.0 * rng.normal(size=(6, 9000))
    bench = Hexapod(unit="flight", seed=seed, drift=5.0)
    record = bench.run(u, run_index=2)
    blocks = list(bench.stream(u, run_index=2, block_samples=999))
    assert np.array_equal(np.hstack([b.readings for b in blocks]), record.outputs)
    assert not np.array_equal(Hexapod(unit="flight", seed=seed).run(u, run_index=2).outputs, record.outputs)
    later = bench.run(u, run_index=40)
    assert np.abs(later.outputs - record.outputs).max() > 0.1


def test_a_slow_drift_changes_matrices_without_a_jolt(seed):
    """A tone through a drifting bench stays as pure as through a steady one, to what the drift itself modulates."""
    t = np.arange(14000) / RATE
    u = np.zeros((6, t.size))
    u[0] = 5.0 * np.sin(2 * np.pi * 80.0 * t)
    quiet = {"unit": "flight", "noise": False, "quantise": False}
    y = Hexapod(**quiet, seed=seed, drift=1.0).run(u).outputs[0]
    steps = np.abs(np.diff(y, 3))[1000:]
    others = np.delete(steps, np.concatenate([np.arange(k - 1010, k - 990) for k in range(3500, 14000, 3500)]))
    print(f"third difference at most {steps.max():.4f} V at renewals, {others.max():.4f} V elsewhere")
    assert steps.max() < 1.01 * others.max()


def law_of(rng, states=5):
    A = np.diag(rng.uniform(-0.9, 0.9, states))
    C = 1e-2 * rng.normal(size=(6, states))
    return StateSpace(A, 1e-2 * rng.normal(size=(states, 6)), C, np.zeros((6, 6)), rate_hz=RATE)


@pytest.mark.parametrize("kind", ["open", "linear", "stepped"])
@pytest.mark.parametrize("own_units", [False, True])
def test_a_campaign_is_its_single_runs_bit_for_bit(kind, own_units, rng, seed):
    law = law_of(rng)
    law = {"open": None, "linear": law, "stepped": SteppedController(law)}[kind]
    u, d = 10.0 * rng.normal(size=(6, 400)), rng.normal(size=(6, 400))
    seeds = [seed, seed + 5, seed + 17, seed, seed + 3]
    bench = Hexapod(unit="flight", hysteresis=True, spread=0.5, drift=1.0)
    records = bench.campaign(seeds, u, d, law, own_units=own_units)
    for each, record in zip(seeds, records, strict=True):
        one = replace(bench, seed=each, unit_seed=each if own_units else 0).run(u, d, law)
        assert record.hash == one.hash
    assert records[0].hash == records[3].hash != records[1].hash


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Hexapod().campaign([], np.zeros((6, 5))), "at least one run"),
        (lambda: Hexapod().campaign([-1], np.zeros((6, 5))), "'seeds' must be at least 0"),
        (lambda: Hexapod().campaign([1], np.zeros((6, 5)), own_units=True), "need a 'spread' above zero"),
        (lambda: Hexapod(spread=-1.0), "'spread' must lie between 0 and 5"),
        (lambda: Hexapod(drift=np.nan), "'drift' must be finite"),
        (lambda: Hexapod(unit_seed=1.5), "'unit_seed' must be a whole number"),
    ],
)
def test_bad_settings_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize("celsius", [np.nan, -300.0, 1e6])
def test_a_temperature_beyond_belief_is_refused(celsius):
    with pytest.raises(InputError, match=r"'temperature_c' must"):
        Hexapod().linear_model(celsius)
    with pytest.raises(InputError, match=r"'temperature_c' must"):
        Hexapod().linear_response([10.0], celsius)
